"""Profile likelihood of a scanned coefficient, such as a time constant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit

WIDEST = 1.0
"""Standard deviation of the logarithm where the likelihood has no maximum within the scan."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Estimate of a scanned coefficient, and of the linear coefficients beside it."""

    value: float
    std: float
    """Estimate of the scanned coefficient and its standard deviation."""
    linear: Array
    linear_stds: Array
    """(s,) estimates of the linear coefficients; the uncertainty of the scanned one is included."""


def profile(values: Sequence[float], fits: Sequence[Fit]) -> Profile:
    """Fit a parabola to the likelihood about its maximum over the logarithm of the scanned coefficient.

    Args:
        values: scanned values, a geometric series.
        fits: fit of the linear coefficients at each of them.
    """
    best = int(np.argmax([fitted.gain for fitted in fits]))
    fitted = fits[best]
    linear, variances = fitted.values, np.diagonal(fitted.covariance)
    if not 0 < best < len(values) - 1:
        return Profile(values[best], WIDEST * values[best], linear, np.sqrt(linear**2 + variances))
    before, after = fits[best - 1], fits[best + 1]
    step = 0.5 * math.log(values[best + 1] / values[best - 1])
    slope = 0.5 * (after.gain - before.gain) / step
    curvature = max((2.0 * fitted.gain - before.gain - after.gain) / step**2, 1.0 / WIDEST**2)
    moved = min(max(slope / curvature, -0.5 * step), 0.5 * step)
    # The scatter over the recording widens the linear coefficients' variance; widen this one as much.
    widened = 2.0 * fitted.gain / fitted.wald
    std = min(math.sqrt(max(widened, 1.0) / curvature), WIDEST)
    by_log = 0.5 * (after.values - before.values) / step
    return Profile(
        value=values[best] * math.exp(moved),
        std=values[best] * std,
        linear=linear + by_log * moved,
        linear_stds=np.sqrt(variances + (by_log * std) ** 2),
    )
