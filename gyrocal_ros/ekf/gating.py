"""Outliers and noise: which innovations to believe, and how noisy the pixels really are."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from gyrocal_ros.data import Array

MIN_FEATURES_FOR_MEDIAN = 4
SLOWEST_NOISE_GAIN = 1.0 / 2000.0
FASTEST_NOISE_GAIN = 1.0 / 50.0


def chi_square_quantile(probability: float, dof: int) -> float:
    """Value below which a chi-square variable stays with the given probability.

    Exact for one and two degrees of freedom, by Wilson and Hilferty (1931) for more: exact to 1 %
    in the middle, a few per cent too wide far out.
    """
    if dof == 1:
        return NormalDist().inv_cdf(0.5 + 0.5 * probability) ** 2
    if dof == 2:
        return -2.0 * math.log1p(-probability)
    width = 2.0 / (9.0 * dof)
    return dof * (1.0 - width + NormalDist().inv_cdf(probability) * math.sqrt(width)) ** 3


def inliers(distances: Array, dof: int, outlier_probability: float) -> np.ndarray:
    """Which innovations to use, (m,) bool, by their squared Mahalanobis distances (m,).

    The gate widens with the median of the image. A fixed gate would throw away exactly the images
    in which something that the model lacks speaks, and leave the filter sure of a wrong answer.
    """
    bound = chi_square_quantile(1.0 - outlier_probability, dof)
    if len(distances) >= MIN_FEATURES_FOR_MEDIAN:
        middle = (len(distances) - 1) // 2  # the lower one of two, so that half may be outliers
        median = float(np.partition(distances, middle)[middle])
        bound *= max(1.0, median / chi_square_quantile(0.5, dof))
    return distances <= bound


class AdaptiveNoise:
    """Follows the standard deviation of a measurement by the median of its innovations.

    Half of the squared innovations should lie below the median of their distribution; each one
    moves the logarithm of the variance towards making that true (stochastic approximation of a
    quantile, Robbins and Monro 1951). The median does not care for outliers, nor for a minority of
    images in which the model fails.
    """

    def __init__(self, std: float, low: float, high: float) -> None:
        self.std = std
        self._low, self._high = low, high
        self._count = 0

    @property
    def is_at_the_top(self) -> bool:
        """Whether the truth may be larger than can be followed."""
        return self.std >= self._high

    def follow(self, distances: Array, dof: int) -> None:
        """Learn from squared Mahalanobis distances (m,) in which the noise followed dominates."""
        if len(distances) == 0:
            return
        self._count += len(distances)
        gain = min(FASTEST_NOISE_GAIN, max(SLOWEST_NOISE_GAIN, 1.0 / self._count)) * len(distances)
        below = float(np.mean(distances < chi_square_quantile(0.5, dof)))
        density_at_median = 0.35  # of log chi-square, close enough for 1 to 3 degrees of freedom
        log_variance_step = min(gain, 0.5) * (0.5 - below) / density_at_median
        self.std = min(self._high, max(self._low, self.std * math.exp(0.5 * log_variance_step)))
