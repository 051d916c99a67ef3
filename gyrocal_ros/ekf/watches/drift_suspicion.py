"""How far the scale factor may have drifted, where a drift shows but is not sure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
DRIFT_MEMORY_S = 120.0
"""Time constant by which what was learned from repeated changes decays."""
INTERVALS = 3.0
"""Mean times between changes after which a next one is no longer expected."""
JUMP_S = 20.0
"""Time in which a jump shows; what takes longer is a drift."""
CONFIRMED_RAD = math.pi / 2.0
"""Turn to either side that confirms a changed scale factor: that of a gyro that errs to one side only seems
to change at the first turn to the other."""


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


@dataclass(frozen=True, slots=True)
class FollowedChanges:
    """Changes of the scale factor that were followed: what has changed twice will change again."""

    count: int = 0
    mean_square: float = 0.0
    interval_s: float = 0.0
    """Mean time between them."""
    age_s: float = 0.0
    """Time since the last one."""
    left_rad: float = math.inf
    """Turn to the left that was measured since the last one; infinite where that needs no confirmation."""
    right_rad: float = math.inf
    """The same to the right."""

    def after(self, duration_s: float, turned_rad: float = 0.0) -> FollowedChanges:
        """Return them after some time, and a turn that was measured, positive to the left."""
        if not self.count:
            return self
        left_rad, right_rad = self.left_rad + max(turned_rad, 0.0), self.right_rad + max(-turned_rad, 0.0)
        return replace(self, age_s=self.age_s + duration_s, left_rad=left_rad, right_rad=right_rad)

    def with_one(self, value: float, *, is_stored: bool = False) -> FollowedChanges:
        """Return them with one more; with that of a stored calibration, which was of another day."""
        count = self.count + 1
        mean_square = self.mean_square + (value**2 - self.mean_square) / count
        interval_s = self.interval_s + (self.age_s - self.interval_s) / self.count if self.count else 0.0
        turned_rad = math.inf if is_stored else 0.0
        return FollowedChanges(count, mean_square, interval_s, left_rad=turned_rad, right_rad=turned_rad)

    @property
    def std(self) -> float:
        """Standard deviation of the next change; zero after a single one, and long after the last one.

        Before the robot has turned to both sides since a change, that may be of one side only.
        """
        if min(self.left_rad, self.right_rad) < CONFIRMED_RAD:
            return math.sqrt(self.mean_square)
        if self.count < 2:
            return 0.0
        expected_s = min(INTERVALS * self.interval_s, DRIFT_MEMORY_S)
        return math.sqrt(self.mean_square) * math.exp(-self.age_s / max(expected_s, JUMP_S))


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
