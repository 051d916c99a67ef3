"""Noise of a heading reference: white noise with heavy tails, a random walk, and jumps.

An outlier lies far from the prediction once. A reference that has jumped, as a localisation does that
corrects itself, stays away: then the alignment of its frame to the map is unknown again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array

OUTLIER_SIGMA = 5.0
"""Innovation beyond which a heading is an outlier, or the reference has jumped."""
JUMP_HEADINGS = 4
"""Number of consecutive outliers to one side that make a jump."""
JUMP_LOG_PRIOR = -7.0
"""Logarithm of the prior probability of a jump at a heading."""

_log_gamma = np.vectorize(math.lgamma, otypes=[float])


@dataclass(frozen=True, eq=False)
class ReferenceNoise:
    """Noise parameters; arrays (m,) hold m alternatives."""

    white_rad: Array | float
    """Scale of the white noise of a heading."""
    walk_rad: Array | float
    """Random walk, rad/sqrt(s)."""
    tail_dof: Array | float
    """Degrees of freedom of the Student t distribution of the innovations; large for normal ones."""

    def alternative(self, place: int) -> ReferenceNoise:
        """Return one of the alternatives."""
        columns = (np.atleast_1d(column) for column in (self.white_rad, self.walk_rad, self.tail_dof))
        return ReferenceNoise(*(float(column[place]) for column in columns))

    def weight(self, distance: Array | float) -> Array | float:
        """Return the weight, at most 1, of a heading whose innovation squared is `distance` variances.

        It is the expected precision of a Student t variable, a normal variable of unknown precision, given
        its value (Lange, Little and Taylor 1989). Without the bound small innovations would count more than
        the white noise permits.
        """
        return np.minimum((self.tail_dof + 1.0) / (self.tail_dof + distance), 1.0)

    def log_likelihood(self, variance: Array | float, distance: Array | float) -> Array | float:
        """Return the log-likelihood of a heading whose innovation squared is `distance` times `variance`."""
        dof = self.tail_dof
        kernel = np.log(variance) + (dof + 1.0) * np.log1p(distance / dof)
        return self._log_constant - 0.5 * kernel

    @cached_property
    def _log_constant(self) -> Array:
        dof = np.asarray(self.tail_dof)
        return _log_gamma(0.5 * (dof + 1.0)) - _log_gamma(0.5 * dof) - 0.5 * np.log(math.pi * dof)


class JumpDetector:
    """Counts consecutive outliers to one side, for m filters side by side."""

    def __init__(self, count: int = 1) -> None:
        self._outliers = np.zeros(count, np.int64)
        self._side = np.zeros(count)

    def update(self, deviation: Array) -> NDArray[np.bool_]:
        """Take the innovations (m,) of a heading, in sigma; return where (m,) the reference has jumped."""
        side = np.sign(deviation) * (np.abs(deviation) > OUTLIER_SIGMA)
        self._outliers = np.where((side != 0.0) & (side == self._side), self._outliers + 1, side != 0.0)
        self._side = side
        has_jumped: NDArray[np.bool_] = self._outliers >= JUMP_HEADINGS
        self._outliers[has_jumped] = 0
        return has_jumped
