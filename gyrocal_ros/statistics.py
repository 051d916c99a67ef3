"""Distributions and tests that several rooms need.

They are written out here because `scipy.special` takes longer to import than a short recording to calibrate.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from gyrocal_ros.data import Array

SMALLEST_P_VALUE = 1e-300
"""Floor of p-values: smaller ones underflow; it corresponds to 37 sigma."""
NORMAL_MAD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
ROUNDING = 1e-16
"""Relative size of a term from which a sum has converged."""
TINY = 1e-300


@lru_cache(maxsize=256)
def chi_square_quantile(probability: float, dof: float) -> float:
    """Return the quantile of the chi-square distribution: the value with the given probability below it.

    Halley's method, from the approximation of Wilson and Hilferty 1931, or in the lowest tail from the first
    term of the series.
    """
    if not 0.0 < probability < 1.0:
        return 0.0 if probability <= 0.0 else math.inf
    spread = 2.0 / (9.0 * dof)
    value = dof * max(1.0 - spread + normal_quantile(probability) * math.sqrt(spread), 0.0) ** 3
    lowest = 2.0 * math.exp((math.log(probability) + math.lgamma(0.5 * dof + 1.0)) / (0.5 * dof))
    value = max(value, lowest)
    for _ in range(50):
        below, above = _chi_square(value, dof)
        error = below - probability if probability < 0.5 else (1.0 - probability) - above
        step = error / _chi_square_density(value, dof)
        bend = (0.5 * dof - 1.0) / value - 0.5
        change = step / max(1.0 - 0.5 * step * bend, 0.5)
        value = max(value - change, 0.5 * value)
        if abs(change) <= 4.0 * ROUNDING * value:
            break
    return value


def chi_square_tail(value: float, dof: float) -> float:
    """Return the probability that a chi-square variable exceeds a value."""
    return _chi_square(value, dof)[1] if value > 0.0 else 1.0


def _chi_square_density(value: float, dof: float) -> float:
    a, x = 0.5 * dof, 0.5 * value
    return 0.5 * math.exp((a - 1.0) * math.log(x) - x - math.lgamma(a))


def _chi_square(value: float, dof: float) -> tuple[float, float]:
    """Return the probabilities that a chi-square variable is below and above a value.

    The regularised incomplete gamma functions, by their series or their continued fraction, whichever
    converges faster (DLMF 8.11.4 and 8.9.2, the latter by the method of Lentz 1976).
    """
    a, x = 0.5 * dof, 0.5 * value
    if math.isinf(x):
        return 1.0, 0.0
    scale = 2.0 * x * _chi_square_density(value, dof)  # x^a e^-x / Gamma(a)
    if x < a + 1.0:
        term = total = 1.0 / a
        while term > ROUNDING * total:
            a += 1.0
            term *= x / a
            total += term
        return scale * total, 1.0 - scale * total
    b = x + 1.0 - a
    c, d = 1.0 / TINY, 1.0 / b
    fraction, k = d, 0
    while True:
        k += 1
        numerator, b = -k * (k - a), b + 2.0
        d = 1.0 / (numerator * d + b or TINY)
        c = numerator / c + b or TINY
        fraction *= c * d
        if abs(c * d - 1.0) <= 2.0 * ROUNDING or k > 10_000:
            return 1.0 - scale * fraction, scale * fraction


def normal_quantile(probability: float) -> float:
    """Return the quantile of the standard normal distribution."""
    return NormalDist().inv_cdf(probability)


def sigma_of(p_value: float) -> float:
    """Convert a two-sided p-value to the number of standard deviations of a normal variable."""
    return -normal_quantile(min(max(p_value, SMALLEST_P_VALUE) / 2.0, 0.5))


def trigamma(x: float) -> float:
    """Return the trigamma function: the variance of the logarithm of a gamma variable of shape `x`.

    Its recurrence up to 10, and from there the asymptotic series (DLMF 5.15.8).
    """
    below = 0.0
    while x < 10.0:
        below += 1.0 / x**2
        x += 1.0
    y = 1.0 / x**2
    rest = 1.0 - y * 5.0 / 7.0 * (1.0 - y * 7.0 / 5.0 * (1.0 - y * 25.0 / 11.0))
    return below + (1.0 + y / 6.0 * (1.0 - y / 5.0 * rest)) / x + 0.5 * y


def vuong_sigma(gains: Array, most: float = math.inf) -> float:
    """Test whether one model predicts better than another (Vuong 1989).

    Args:
        gains: (B,) log-likelihood gained in each block of time.
        most: gain or loss in a block beyond which it counts no more. Where a few blocks gain thousands, their
            scatter would otherwise hide that they all gain.

    Returns:
        Sum of the gains over its standard deviation by their scatter; 0 where there is no scatter.
    """
    gains = np.clip(gains, -most, most)
    scatter = float(gains.std(ddof=1)) * math.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return float(gains.sum()) / scatter if scatter > 0.0 else 0.0


def robust_std(values: Array) -> float:
    """Estimate the standard deviation about zero by the median magnitude; 0 for an empty array."""
    return NORMAL_MAD * float(np.median(np.abs(values))) if len(values) else 0.0


def nis_per_dof(nis: Array, dof: Array) -> float | None:
    """Return the normalised innovation squared per degree of freedom; None where nothing was measured."""
    total = float(np.sum(dof))
    return float(np.sum(nis)) / total if total > 0.0 else None
