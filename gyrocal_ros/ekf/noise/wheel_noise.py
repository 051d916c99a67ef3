"""The noise of the wheels, learned from the images; that of the settings is the least.

Once the depths are known, an image tells the way since the last one far better than the wheels do. So its
innovation shows how much these err, along the way and across it: the derivative of the log-likelihood by the
logarithm of each variance is followed to where it is zero on average (Fisher scoring; Myers and Tapley 1976).
Encoders that send less often than the camera err alike in several images, so those of some time count
together. A map of another size errs alike for longer, so only what changes from one time to the next counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from gyrocal_ros.config.sections import WheelConfig
from gyrocal_ros.data import Array, MotionBlock, quickly_filled

BATCH_S = 0.5
"""Time over which the errors of the wheels may be alike."""
MAX_RATIO = 9.0
"""Square of an error, relative to its expected value, beyond which it counts no more: it is not noise."""
MEMORY = 200.0
"""Number of batches over which the noise is averaged."""
PRIOR_BATCHES = 5.0
"""Number of batches that the settings are worth."""
MAX_STEP = 0.5
"""Largest change of the logarithm of a variance by one batch."""
MAX_LOG_VARIANCE = math.log(400.0)
"""Largest logarithm of a variance, relative to that of the settings."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class PositionScore:
    """What the innovation of an image tells of the position on the floor before the update."""

    score: Array
    """(2,) A^T S^-1 nu, with A the derivative of the prediction by the position."""
    information: Array
    """(2, 2) A^T S^-1 A."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """Errors of the wheels along the way and across it, in some images."""

    errors: tuple[float, float]
    """Sums of the scores by errors of one expected standard deviation each."""
    expected: tuple[float, float]
    """Expected squares of these sums."""
    images: int
    duration_s: float


_EMPTY = _Batch((0.0, 0.0), (0.0, 0.0), 0, 0.0)


class WheelNoise:
    """Learns the noise along the way, turns included, and across it.

    Args:
        settings: the least noise.
    """

    def __init__(self, settings: WheelConfig) -> None:
        self.config = settings
        """The settings with the noise that is known now."""
        self._settings = settings
        self._log_variances, self._information = [0.0, 0.0], [PRIOR_BATCHES, PRIOR_BATCHES]
        self._before, self._batch = _EMPTY, _EMPTY
        self.forget()

    @property
    def drives(self) -> bool:
        """True if the wheels have driven the robot ahead or back since the last image."""
        return self._way_m > 0.0

    def forget(self) -> None:
        """Forget the way since the last image."""
        self._way_m = self._turn_rad = self._since_s = 0.0

    def move(self, block: MotionBlock) -> None:
        """Add the way of a block to that since the last image."""
        *_, way_m, turn_rad = block.way_and_turn()
        self._way_m += way_m
        self._turn_rad += turn_rad
        self._since_s += block.duration_s

    def learn(self, told: PositionScore | None, yaw_rad: float) -> None:
        """Learn from an image, and begin the way to the next one.

        Args:
            told: by the image; None where it does not tell of the noise of the wheels.
            yaw_rad: heading.
        """
        if told is not None and self._way_m > 0.0:
            self._add(told, yaw_rad)
        self.forget()
        if self._batch.duration_s >= BATCH_S:
            self._follow(self._before, self._batch)
            self._before, self._batch = self._batch, _EMPTY

    def _add(self, told: PositionScore, yaw_rad: float) -> None:
        """Add an image to the batch, by what its wheels err by along the way and across it."""
        wheels, cos, sin = self.config, math.cos(yaw_rad), math.sin(yaw_rad)
        along_m = math.sqrt(
            wheels.distance_noise_m**2 * self._way_m + wheels.turn_noise_m**2 * self._turn_rad
        )
        across_m = wheels.lateral_noise_m * math.sqrt(self._way_m)
        x, y = told.score.tolist()
        (xx, xy), (_, yy) = told.information.tolist()
        both = 2.0 * xy * cos * sin
        batch = self._batch
        (along, across), (expected_along, expected_across) = batch.errors, batch.expected
        self._batch = _Batch(
            (along + along_m * (x * cos + y * sin), across + across_m * (y * cos - x * sin)),
            (
                expected_along + along_m**2 * (xx * cos**2 + yy * sin**2 + both),
                expected_across + across_m**2 * (xx * sin**2 + yy * cos**2 - both),
            ),
            batch.images + 1,
            batch.duration_s + self._since_s,
        )

    def _follow(self, before: _Batch, batch: _Batch) -> None:
        """Follow the noise by the change of the errors from one batch to the next."""
        if not before.images:
            return
        images = before.images + batch.images
        for axis in range(2):
            error = batch.errors[axis] - before.errors[axis]
            expected = (batch.expected[axis] + before.expected[axis]) / images
            score = min(error * error / images, MAX_RATIO * expected) - expected
            faded = (1.0 - 1.0 / MEMORY) * self._information[axis]
            self._information[axis] = max(faded, PRIOR_BATCHES) + expected * expected
            step = min(max(score / self._information[axis], -MAX_STEP), MAX_STEP)
            self._log_variances[axis] = min(max(self._log_variances[axis] + step, 0.0), MAX_LOG_VARIANCE)
        along, across = (math.exp(0.5 * log_variance) for log_variance in self._log_variances)
        settings = self._settings
        self.config = replace(
            settings,
            distance_noise_m=along * settings.distance_noise_m,
            lateral_noise_m=across * settings.lateral_noise_m,
            turn_noise_m=along * settings.turn_noise_m,
        )
