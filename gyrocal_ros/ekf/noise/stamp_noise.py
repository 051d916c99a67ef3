"""Noise of the stamps of images: that of a camera which is stamped when its images arrive, by some ms.

In a turn, an error of the stamp moves all features at once, by far more than the noise of the pixels. It is
white. What the model of the gyro lacks adds up in the heading: from image to image it grows, or stays, and
second differences of the headings do not contain it.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.state.layout import YAW
from gyrocal_ros.kernels import compiled

PRIOR_STD_S, PRIOR_WEIGHT = 0.0015, 3
"""Noise of stamps before anything is known of it, and number of images that it counts for. Without, noisy
stamps would count for exact ones in the first turn, and later the scale factor would seem to have changed."""
MAX_STD_S = 0.03
"""Largest noise of stamps; what exceeds it is no noise."""
TELLING_STD_S = 0.002
"""Standard deviation up to which an image tells the error of its stamp, if it had no noise."""
FEW = 10
"""Number of second differences, with the prior, from which they tell the noise. A few small ones by chance
made the stamps exact for the rest of the first turn, and the scale factor seemed to change in the next."""
MEMORY = 60
"""Number of second differences whose median counts."""
CLEAR = 4.0
"""Excess over the variance expected with exact stamps, relative to it, from which the stamps have noise. With
less, what a missing effect does at the beginning of a turn seemed to be some."""
WEIGHTS = 1.0, 4.0, 1.0
"""Weights of three variances in that of their second difference."""
MEDIAN = 0.4549
"""Median of a chi-square variable with one degree of freedom."""


class StampError(NamedTuple):
    """What an image tells of the error of its stamp."""

    error_s: float
    """The error that explains its innovation best."""
    variance_s2: float
    """Its variance, with the present noise of the stamps."""
    yaw_rate_rad_s: float


class _Turned(NamedTuple):
    """The error as a turn."""

    turn_rad: float
    known_rad2: float
    by_stamp_rad2: float
    """Its variance with exact stamps, and that which a stamp with a noise of 1 s adds."""


class StampNoise:
    """Learns the standard deviation of the stamps by three images at a time in turns."""

    def __init__(self) -> None:
        self.std_s = PRIOR_STD_S
        self.learned_s = 0.0
        """Standard deviation that the images show; 0 while nothing is known of it, too."""
        self._last: deque[_Turned] = deque(maxlen=len(WEIGHTS))
        prior = [(MEDIAN * PRIOR_STD_S**2, 0.0)] * PRIOR_WEIGHT
        self._differences: deque[tuple[float, float]] = deque(prior, maxlen=MEMORY)

    def learn(self, seen: StampError | None) -> None:
        """Learn from the innovation of an image; None for one that tells nothing."""
        known_s2 = math.inf if seen is None else seen.variance_s2 - self.std_s**2
        if seen is None or known_s2 >= TELLING_STD_S**2:
            self._last.clear()
            return
        squared_rate = seen.yaw_rate_rad_s**2
        self._last.append(_Turned(seen.error_s * seen.yaw_rate_rad_s, known_s2 * squared_rate, squared_rate))
        if len(self._last) < len(WEIGHTS):
            return
        first, middle, last = (item.turn_rad for item in self._last)
        weighted = list(zip(WEIGHTS, self._last, strict=True))
        known_rad2 = sum(weight * item.known_rad2 for weight, item in weighted)
        by_stamp_rad2 = sum(weight * item.by_stamp_rad2 for weight, item in weighted)
        square = (first - 2.0 * middle + last) ** 2
        self._differences.append((square / by_stamp_rad2, known_rad2 / by_stamp_rad2))
        squares, known = map(median, zip(*self._differences, strict=True))
        excess_s2 = squares / MEDIAN - known
        std_s = min(math.sqrt(excess_s2), MAX_STD_S) if excess_s2 > CLEAR * known else 0.0
        if len(self._differences) < FEW:
            self.std_s = max(std_s, PRIOR_STD_S)
        else:
            self.std_s = self.learned_s = std_s


def stamp_error(by_pose: Array, rate: Array, residual: Array, whitening: Array) -> StampError | None:
    """Return the error of the stamp that explains an innovation best; None for an image without motion.

    The arguments are those of `stamp_score`.
    """
    score, information = stamp_score(by_pose, rate, residual, whitening)
    yaw_rate_rad_s = float(rate[YAW])
    if information <= 0.0 or yaw_rate_rad_s == 0.0:
        return None
    return StampError(score / information, 1.0 / information, yaw_rate_rad_s)


@compiled
def stamp_score(by_pose: Array, rate: Array, residual: Array, whitening: Array) -> tuple[float, float]:
    """Return score and information of an innovation about the error of its stamp.

    Args:
        by_pose: (m, r, 6) derivative of the prediction by the pose.
        rate: (6,) of the pose, per s.
        residual: nu (m, r).
        whitening: L^-1 (m r, m r) with `L L^T = S`.
    """
    by_error, whitened = whitening @ (by_pose @ rate).ravel(), whitening @ residual.ravel()
    return float(by_error @ whitened), float(by_error @ by_error)


def with_stamp_noise(covariance: Array, velocity: Array, std_s: float) -> Array:
    """Return the covariance (m, r, m, r) of an innovation with noise of the stamp.

    Args:
        covariance: without it.
        velocity: (m, r) of the features in the image, per s.
        std_s: standard deviation of the stamp.
    """
    moved = std_s * velocity
    total: Array = covariance + moved[:, :, None, None] * moved
    return total
