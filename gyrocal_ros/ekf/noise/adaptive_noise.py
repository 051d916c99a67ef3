"""Adaptive estimation of measurement noise from innovations."""

from __future__ import annotations

import math

from gyrocal_ros.data import Array
from gyrocal_ros.statistics import chi_square_quantile

MIN_GAIN, MAX_GAIN = 1.0 / 1000.0, 1.0 / 50.0
"""Bounds of the gain of a single innovation."""
MAX_STEP = 0.5
"""Largest gain of all innovations of one measurement together."""
DENSITY_AT_MEDIAN = 0.35
"""Density of the logarithm of a chi-square variable at its median, for 1 to 3 degrees of freedom."""


class AdaptiveNoise:
    """Estimates the standard deviation of a measurement by the median of its innovations.

    Half of the squared innovations should be below the median of their distribution; each innovation moves
    the logarithm of the variance towards making that true (stochastic approximation of a quantile, Robbins
    and Monro 1951). The median is robust against outliers and against a minority of images in which the
    model fails.
    """

    def __init__(self, std: float, low: float, high: float) -> None:
        self.std = std
        self._low, self._high = low, high
        self._count = 0

    @property
    def is_at_limit(self) -> bool:
        """True if the estimate has reached its upper bound."""
        return self.std >= self._high

    def update(self, distances: Array, dof: int) -> None:
        """Learn from squared Mahalanobis distances (m,) of innovations that this noise dominates."""
        if len(distances) == 0:
            return
        self._count += len(distances)
        gain = min(MAX_GAIN, max(MIN_GAIN, 1.0 / self._count)) * len(distances)
        middle = chi_square_quantile(0.5, dof)
        below = sum(distance < middle for distance in distances.tolist()) / len(distances)
        log_variance_step = min(gain, MAX_STEP) * (0.5 - below) / DENSITY_AT_MEDIAN
        self.std = min(self._high, max(self._low, self.std * math.exp(0.5 * log_variance_step)))
