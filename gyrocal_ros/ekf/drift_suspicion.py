"""How far the scale factor may have drifted, where a drift shows but is not sure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import quickly_filled

RAMP_S = 300.0
"""Time of the change that is the unit of a drift."""
DRIFT_STD = 0.005
"""Largest standard deviation of the drift of a scale factor over `RAMP_S` while the ramp is hardly known."""
USUAL_DRIFT_STD = 0.001
"""The same of a usual gyro: 0.01 % per K (`gyro.scale_temperature_std`) and 10 K of warm-up. Beside a heading
reference it bounds a ramp that chance explains: a random walk of headings is full of such ramps."""
COUNTS_SIGMA = 1.0
"""Significance from which a ramp is looked at."""
CHANCE_SIGMA = 3.0
"""Significance from which chance does not explain a ramp. By tracks of images it counts from there only:
their slow errors are largest in the first turns, which then differ from the later ones."""
JUMP_S = 20.0
"""Time in which a jump shows; what takes longer is a drift."""


@quickly_filled
@dataclass(frozen=True, slots=True)
class HeadingErrors:
    """Errors of the headings by the images that innovations do not show."""

    repeated_rad: float = 0.0
    """Standard deviation of an error that several headings have in common."""
    slow_rad: float = 0.0
    """That of a heading by slow errors of the tracks, another one in each turn."""
    are_by_tracks: bool = False
    """True if a tracker finds the features."""


EXACT = HeadingErrors()


@quickly_filled
@dataclass(frozen=True, slots=True)
class Ramp:
    """Scale factor that changes at a constant rate."""

    value: float
    """Change over `RAMP_S`."""
    variance: float
    sigma: float
    """Significance; zero where hardly anything is known of it."""
    age_s: float
    turned_rad: float
    """Turn in that time, to both sides."""

    def variance_by(self, errors: HeadingErrors) -> float:
        """Return the variance by slow errors of the headings.

        That of the slope of a line through n values of the scale factor, one for each turn by pi.
        """
        if not errors.slow_rad or not self.age_s:
            return 0.0
        turns = max(self.turned_rad / math.pi, 1.0)
        return 12.0 * (errors.slow_rad / math.pi) ** 2 / turns * (RAMP_S / self.age_s) ** 2


def suspected_drift(
    ramp: Ramp, errors: HeadingErrors, chance_drift_std: float, went_on_drift: float
) -> float:
    """Return the standard deviation of a drift over `RAMP_S`.

    Its variance p is what the ramp suggests (empirical Bayes, Morris 1983), at most that of a gyro. A ramp
    counts from 1.4 times its standard deviation: the price of one more parameter (Akaike 1974), or every
    clean recording would pay.

    Args:
        ramp: what the measurements show.
        errors: of the headings.
        chance_drift_std: largest standard deviation of a drift that chance explains.
        went_on_drift: size of a change that was a ramp and may go on; 0 without.
    """
    r, v = ramp.value, ramp.variance + ramp.variance_by(errors)
    sigma = min(ramp.sigma, abs(r) / math.sqrt(v)) if v > 0.0 else ramp.sigma
    counts = sigma > (CHANCE_SIGMA if errors.are_by_tracks else COUNTS_SIGMA)
    largest = DRIFT_STD if sigma > CHANCE_SIGMA else chance_drift_std
    p = min(r**2 - 2.0 * v, largest**2) if counts and ramp.age_s >= JUMP_S else 0.0
    p = max(p, went_on_drift**2)
    if p == 0.0:
        return 0.0
    return math.hypot(r / (1.0 + v / p), math.sqrt(p / (1.0 + p / v)))
