"""Distributions and tests that several rooms need; the special functions come from SciPy."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import special

from gyrocal_ros.data import Array

SMALLEST_P_VALUE = 1e-300
"""Floor of p-values: smaller ones underflow; it corresponds to 37 sigma."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""


@lru_cache(maxsize=256)
def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the quantile of the chi-square distribution: the value with the given probability below it."""
    return float(special.chdtri(dof, 1.0 - probability))


def chi_square_tail(value: float, dof: float) -> float:
    """Return the probability that a chi-square variable exceeds a value."""
    return float(special.chdtrc(dof, max(value, 0.0)))


def normal_quantile(probability: float) -> float:
    """Return the quantile of the standard normal distribution."""
    return float(special.ndtri(probability))


def sigma_of(p_value: float) -> float:
    """Convert a two-sided p-value to the number of standard deviations of a normal variable."""
    return -normal_quantile(min(max(p_value, SMALLEST_P_VALUE) / 2.0, 0.5))


def trigamma(x: float) -> float:
    """Return the trigamma function: the variance of the logarithm of a gamma variable of shape `x`."""
    return float(special.polygamma(1, x))


def vuong_sigma(gains: Array, most: float = math.inf) -> float:
    """Test whether one model predicts better than another (Vuong 1989).

    Args:
        gains: (B,) log-likelihood gained in each block of time.
        most: gain or loss in a block beyond which it counts no more. Where a few blocks gain thousands, their
            scatter would otherwise hide that they all gain.

    Returns:
        Sum of the gains over its standard deviation by their scatter; infinite where all blocks gain, or
        lose, so much that they count no more; 0 where there is no scatter otherwise.
    """
    gains = np.clip(gains, -most, most)
    scatter = float(gains.std(ddof=1)) * math.sqrt(len(gains)) if len(gains) > 1 else 0.0
    if scatter > 0.0:
        return float(gains.sum()) / scatter
    return math.copysign(math.inf, gains[0]) if len(gains) > 1 and abs(gains[0]) == most else 0.0


def robust_std(values: Array) -> float:
    """Estimate the standard deviation about zero by the median magnitude; 0 for an empty array."""
    return NORMAL_MAD * float(np.median(np.abs(values))) if len(values) else 0.0


def nis_per_dof(nis: Array, dof: Array) -> float | None:
    """Return the normalised innovation squared per degree of freedom; None where nothing was measured."""
    total = float(np.sum(dof))
    return float(np.sum(nis)) / total if total > 0.0 else None
