"""A coefficient inside a nonlinear function, told by the likelihood over the values that were tried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.diagnose.candidate_fit import Fit

WIDEST = 1.0
"""Standard deviation of the logarithm where the likelihood does not tell."""


@dataclass(frozen=True, slots=True)
class Profile:
    """A time constant and what its doubt does to the amplitude."""

    value: float
    std: float
    amplitude: float
    amplitude_std: float


def profile(values: Sequence[float], fits: Sequence[Fit]) -> Profile:
    """Fit a parabola to the likelihood about its largest value.

    Args:
        values: of the coefficient, a geometric series.
        fits: of the amplitude at each of them.
    """
    best = int(np.argmax([fitted.gain for fitted in fits]))
    fitted = fits[best]
    amplitude, variance = float(fitted.values[0]), float(fitted.covariance[0, 0])
    if not 0 < best < len(values) - 1:
        return Profile(
            values[best], WIDEST * values[best], amplitude, math.hypot(amplitude, math.sqrt(variance))
        )
    before, after = fits[best - 1], fits[best + 1]
    step = 0.5 * math.log(values[best + 1] / values[best - 1])
    slope = 0.5 * (after.gain - before.gain) / step
    curvature = max((2.0 * fitted.gain - before.gain - after.gain) / step**2, 1.0 / WIDEST**2)
    moved = min(max(slope / curvature, -0.5 * step), 0.5 * step)
    # The scatter over the recording widens the amplitude's doubt; let it widen this one as much.
    widened = variance * 2.0 * fitted.gain / amplitude**2
    std = min(math.sqrt(max(widened, 1.0) / curvature), WIDEST)
    by_log = 0.5 * float(after.values[0] - before.values[0]) / step
    return Profile(
        value=values[best] * math.exp(moved),
        std=values[best] * std,
        amplitude=amplitude + by_log * moved,
        amplitude_std=math.hypot(math.sqrt(variance), by_log * std),
    )
