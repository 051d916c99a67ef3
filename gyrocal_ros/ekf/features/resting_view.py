"""What a robot at rest sees: a feature that shifts while others stay moves by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.model.camera import bearing
from gyrocal_ros.model.features.base import PosedCamera

MIN_SHIFT_PX = 0.5
"""Shift from which a feature is elsewhere; matching errors of a robot at rest stay below."""
SHIFT_SIGMAS = 5.0
"""The same in standard deviations of the pixels."""
SHIFTED_IMAGES = 3
"""Successive images in which it is elsewhere before that is a shift: one may hold a wrong match."""
MIN_SHIFTS = 2
"""Shifts from which a feature moves on: where it was seen first may be a wrong match, too."""
MIN_STAYING = 3
"""Features that stay, from which the robot does. If it were moved, all would shift."""


@dataclass(slots=True)
class _Feature:
    direction: Array
    """(3,) unit vector to where it is expected, in the axes of the map."""
    since: int
    """Number of the image that shows it there."""
    elsewhere: int = 0
    """Successive images that show it elsewhere."""
    shifts: int = 0


class RestingView:
    """Compares where a robot at rest sees features with where it saw them before."""

    def __init__(self) -> None:
        self._features: dict[int, _Feature] = {}
        self._images = 0
        self.is_still = False
        """True if the last image shows that the robot has not moved since the one before."""

    def leave(self) -> None:
        """Forget all: the robot moves."""
        self._features, self.is_still = {}, False

    def see(
        self, ids: IntArray, pixels: Array, view: PosedCamera, noise_px: float
    ) -> tuple[IntArray, IntArray]:
        """Take an image of a robot at rest.

        Returns the ids of the features that have shifted now, and of those that go on moving.

        Args:
            ids: (m,) features in view.
            pixels: (m, 2) their observations.
            view: camera as the robot stands; only its attitude is used, which sways.
            noise_px: standard deviation of the pixels.
        """
        self._images += 1
        directions = np.column_stack([bearing(view.camera, pixels), np.ones(len(ids))]) @ view.R_wc.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        max_shift_rad = max(MIN_SHIFT_PX, SHIFT_SIGMAS * noise_px) / view.camera.fx_px
        before = self._features
        self._features = {
            feature: before.get(feature) or _Feature(direction, self._images)
            for feature, direction in zip(ids.tolist(), directions, strict=True)
        }
        features = list(self._features.values())
        for feature, direction in zip(features, directions, strict=True):
            is_elsewhere = np.linalg.norm(direction - feature.direction) > max_shift_rad
            feature.elsewhere = feature.elsewhere + 1 if is_elsewhere else 0
        has_shifted = self._has_shifted(features, directions)
        is_moving = np.array([item.shifts >= MIN_SHIFTS for item in features], bool)
        return ids[has_shifted], ids[is_moving]

    def _has_shifted(self, features: list[_Feature], directions: Array) -> np.ndarray:
        """Return which features (m,), bool, seen in directions (m, 3), have shifted.

        Only features that were seen before another one can tell that the robot has not moved since.
        One that has shifted is compared with its new place from then on.
        """
        has_shifted = np.zeros(len(features), bool)
        staying = sorted(item.since for item in features if not item.elsewhere and not item.shifts)
        if len(staying) < MIN_STAYING:
            self.is_still = False
            return has_shifted
        since = staying[MIN_STAYING - 1]
        self.is_still = since < self._images
        for place, feature in enumerate(features):
            if feature.elsewhere >= SHIFTED_IMAGES and feature.since >= since:
                feature.direction, feature.since, feature.elsewhere = directions[place], self._images, 0
                feature.shifts += 1
                has_shifted[place] = True
        return has_shifted
