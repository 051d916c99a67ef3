"""What a run learns of the errors of the tracks, and of the stamps of their images."""

from __future__ import annotations

import math

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.features.feature_noise import TypicalMatch
from gyrocal_ros.ekf.features.repeated_errors import RepeatedErrors
from gyrocal_ros.ekf.features.slow_errors import SlowErrors
from gyrocal_ros.ekf.noise.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.noise.stamp_noise import StampNoise

COMMON_PART, MAX_COMMON_PX = 0.8, 0.12
"""Standard deviation of an error that all matches of a turn have in common where motion blurs the images:
relative to the noise of one feature, and at most. What is learned of that grows with a wrong scale factor."""
SLIDING_PX = 0.5
"""The same where a tracker finds the features: some of them slide until they are found out, see
`contradictions`, and turn the map."""
TURN_PX_BY_SLOW = 25.0
"""Standard deviation of the error of a heading by slow errors, times the focal length, relative to the root
of their variance (px^2 per px). In the first turns of four recordings of two other simulators the error was
0.2 to 0.8 px."""
MIN_PIXEL_NOISE_PX, MAX_PIXEL_NOISE_PX = 0.01, 5.0
"""Bounds of the estimated pixel noise; at the upper one the images do not fit the estimate."""


class TrackNoise:
    """Learns the size of the errors of the features, and how they last.

    Args:
        std_px: standard deviation of the pixels of a feature, before anything is learned.
        is_robust: True if features are anchored inverse depths, each judged by the others.
        is_known: True if the settings are the truth, and nothing is to be learned.
    """

    def __init__(self, std_px: float, *, is_robust: bool, is_known: bool) -> None:
        self._is_robust = is_robust
        self.pixel = AdaptiveNoise(std_px, MIN_PIXEL_NOISE_PX, max(MAX_PIXEL_NOISE_PX, 5.0 * std_px))
        self._repeated, self._slow = RepeatedErrors(std_px), SlowErrors()
        self._typical_match = TypicalMatch()
        self._stamp = StampNoise() if is_robust and not is_known else None

    @property
    def match_px(self) -> float:
        """Standard deviation that the tracker tells of a typical match."""
        return self._typical_match.std_px

    @property
    def slow_variance_px(self) -> float:
        """Variance of the walk of features by slow errors, px^2 per px of motion."""
        return self._slow.variance_px

    @property
    def stamp_std_s(self) -> float:
        """Standard deviation of the stamps of the images, as expected at first and then as learned."""
        return self._stamp.std_s if self._stamp else 0.0

    @property
    def learned_stamp_std_s(self) -> float:
        """That which the images show; 0 for stamps that are exact, and while nothing is known of them."""
        return self._stamp.learned_s if self._stamp else 0.0

    @property
    def common_px(self) -> float:
        """Standard deviation of an error that all features of a turn have in common."""
        sliding_px = SLIDING_PX if self.are_tracked else 0.0
        return math.hypot(min(COMMON_PART * self.pixel.std, MAX_COMMON_PX), sliding_px)

    @property
    def are_tracked(self) -> bool:
        """True if a tracker finds the features in images."""
        return self._typical_match.is_known

    @property
    def turn_px(self) -> float:
        """Standard deviation of the error of the heading by slow errors, times the focal length."""
        return TURN_PX_BY_SLOW * math.sqrt(self._slow.variance_px)

    @property
    def errors_repeat(self) -> bool:
        """True if the errors of unmoved features repeat."""
        return self._is_robust and self._repeated.are_expected(self.pixel.std)

    def see(self, covariances_px2: Array | None) -> None:
        """Take what the tracker tells of the matches (m, 2, 2) of an image."""
        if covariances_px2 is not None:
            self._typical_match.update(covariances_px2)

    def learn(self, update: MeasurementUpdate, *, agrees: bool) -> None:
        """Learn from the update by an image.

        Args:
            update: by the image.
            agrees: True if the image agrees with the map: errors that last are no fault of the map then.
        """
        self.pixel.update(update.noise_distances, 2)
        if self._is_robust:
            self._repeated.update(update.changes_px2)
        if self._stamp:
            self._stamp.learn(update.stamp_error)
        if agrees and len(update.differences):
            self._slow.learn(update.used_ids, update.differences)
