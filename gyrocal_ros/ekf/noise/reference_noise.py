"""Noise of a heading reference: white noise with heavy tails, a random walk, stamps that scatter, and jumps.

An outlier lies far from the prediction once. A reference that has jumped, as a localisation does that
corrects itself, stays away: then the alignment of its frame to the map is unknown again. One that smooths its
headings lies apart while the robot begins or ends a turn, and comes back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, IntArray, MotionBlock

OUTLIER_SIGMA = 5.0
"""Innovation beyond which a heading is an outlier, or the reference has jumped."""
STAYS_SIGMA = 2.5
"""Innovation beyond which the headings after an outlier stay on its side: half of it, for their own noise."""
JUMP_HEADINGS = 4
"""Number of consecutive headings on the side of an outlier, from it on, after which the reference may have
jumped."""
JUMP_S = 1.0
"""Time for which they go on if it has."""
JUMP_LOG_PRIOR = -7.0
"""Logarithm of the prior probability of a jump at a heading."""
TURN_MEMORY_S = 3.0
"""Time over which the turn before a jump is remembered."""
MIN_JUMPS, JUMPS_SIGMA = 6, 2.4
"""Fewest jumps, and significance of their sum in the direction of the turns, from which they are part of the
turns: six of one size in that direction."""

_log_gamma = np.vectorize(math.lgamma, otypes=[float])


@dataclass(frozen=True, eq=False)
class ReferenceNoise:
    """Noise parameters; arrays (m,) hold m alternatives."""

    white_rad: Array | float
    """White noise of a heading: standard deviation of normal noise that tells as much."""
    walk_rad: Array | float
    """Random walk, rad/sqrt(s)."""
    tail_dof: Array | float
    """Degrees of freedom of the Student t distribution of the innovations; large for normal ones."""
    stamp_s: Array | float = 0.0
    """Standard deviation of the stamps: noise in proportion to the rate."""

    def alternative(self, place: int) -> ReferenceNoise:
        """Return one of the alternatives."""
        columns = (self.white_rad, self.walk_rad, self.tail_dof, self.stamp_s)
        return ReferenceNoise(*(float(np.atleast_1d(column)[place]) for column in columns))

    def weight(self, distance: Array | float) -> Array | float:
        """Return the weight, at most 1, of a heading whose innovation squared is `distance` variances.

        Without the bound small innovations would count more than the white noise permits.
        """
        return np.minimum(self._slope(distance), 1.0)

    def pull(self, distance: Array | float, noise_part: Array | float) -> Array | float:
        """Return the factor on an innovation by which it moves the estimate.

        It is that of the score of a Student t variable over that of a normal one (Masreliez 1975). On average
        it makes up for the outliers, which move the estimate less; a bound would be taken for a larger random
        walk. As far as the estimate is uncertain, small innovations are normal.

        Args:
            distance: square of the innovation, in variances.
            noise_part: part of the variance that is noise of the heading.
        """
        slope = self._slope(distance)
        return np.where(slope < 1.0, slope, 1.0 + noise_part * (slope - 1.0))

    def log_likelihood(self, variance: Array | float, distance: Array | float) -> Array | float:
        """Return the log-likelihood of a heading whose innovation squared is `distance` times `variance`."""
        dof = self.tail_dof
        kernel = np.log(variance) + (dof + 1.0) * np.log1p(self.wider * distance / dof)
        return self.log_constant - 0.5 * kernel

    def _slope(self, distance: Array | float) -> Array | float:
        return (self.tail_dof + 3.0) / (self.tail_dof + self.wider * distance)

    @cached_property
    def wider(self) -> Array:
        """Variance of normal noise over the squared scale of Student t noise that tells as much.

        The Fisher information of the latter is (dof + 1) / (dof + 3) over its squared scale (Lange, Little
        and Taylor 1989).
        """
        dof = np.asarray(self.tail_dof)
        return (dof + 3.0) / (dof + 1.0)

    @cached_property
    def log_constant(self) -> Array:
        """Part of the log-likelihood that depends on the degrees of freedom alone."""
        dof = np.asarray(self.tail_dof)
        scale = 0.5 * np.log(self.wider / (math.pi * dof))
        return _log_gamma(0.5 * (dof + 1.0)) - _log_gamma(0.5 * dof) + scale


class JumpDetector:
    """Counts the headings that stay on the side of an outlier, for m filters side by side."""

    def __init__(self, count: int = 1) -> None:
        self.outliers: IntArray = np.zeros(count, np.int64)
        """(m,) number of headings on that side, the outlier included; zero without."""
        self.side: Array = np.zeros(count)
        """(m,) sign of the outlier, zero without."""
        self.since_s: Array = np.zeros(count)
        """(m,) time since the outlier."""

    @property
    def are_apart(self) -> NDArray[np.bool_]:
        """(m,) True from an outlier on, as long as the headings stay on its side."""
        return self.outliers > 0

    def update(self, deviation: Array, dt_s: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Take the innovations of a heading.

        Args:
            deviation: (m,) innovations in sigma.
            dt_s: time since the heading before.

        Returns:
            Where (m,) the reference may have jumped, so that the heading is not used, and where it has.
        """
        goes_on = deviation * self.side > STAYS_SIGMA
        side = np.sign(deviation) * (np.abs(deviation) > OUTLIER_SIGMA)
        self.outliers = np.where(goes_on, self.outliers + 1, side != 0.0)
        self.since_s = np.where(goes_on, self.since_s + dt_s, 0.0)
        self.side = np.where(goes_on, self.side, side)
        may_have: NDArray[np.bool_] = self.outliers >= JUMP_HEADINGS
        has_jumped = may_have & (self.since_s >= JUMP_S)
        self.outliers[has_jumped], self.side[has_jumped] = 0, 0.0
        return may_have & ~has_jumped, has_jumped


class JumpsWithTurns:
    """Compares the jumps of a reference with the turns before them.

    Jumps of a localisation go either way. A reference that smooths its headings stays behind in every turn.
    """

    def __init__(self) -> None:
        self._recent_rad = self._turned_rad = 0.0
        self._jumps_rad: list[float] = []

    def move(self, block: MotionBlock) -> None:
        """Follow one block of the gyro."""
        turn_rad = float(block.rate_rad_s[:, 2] @ block.dt_s)
        self._recent_rad = self._recent_rad * math.exp(-block.duration_s / TURN_MEMORY_S) + turn_rad
        self._turned_rad += abs(turn_rad)

    def add(self, jump_rad: float) -> None:
        """Take a jump."""
        self._jumps_rad.append(math.copysign(jump_rad, jump_rad * self._recent_rad))

    @property
    def scale_error(self) -> float:
        """Error of the scale factor if the jumps were part of the turns; 0 where chance explains them."""
        together, size = math.fsum(self._jumps_rad), math.hypot(*self._jumps_rad)
        if len(self._jumps_rad) < MIN_JUMPS or abs(together) < JUMPS_SIGMA * size:
            return 0.0
        return abs(together) / self._turned_rad
