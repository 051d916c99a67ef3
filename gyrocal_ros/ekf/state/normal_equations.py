"""Errors that are estimated together from the innovations: sums of `G^T S^-1 G` and `G^T S^-1 nu`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, quickly_filled
from gyrocal_ros.ekf.state.positive_definite import solve
from gyrocal_ros.kernels import compiled


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Sums over a run for q errors that are estimated together."""

    information: Array
    """(q, q)"""
    score: Array
    """(q,)"""
    values: Array
    """(q,) estimates."""
    explained: float
    """Part of the NIS that they explain."""


def normal_equations(information: Array, score: Array) -> NormalEquations:
    """Estimate errors by the information on them (q, q) and their score (q,)."""
    values = solve(information, score)
    return NormalEquations(information, score, values, float(score @ values))


@compiled
def equations_added(
    sums: NormalEquations, information: Array, score: Array, first: int
) -> tuple[Array, Array, Array, float]:
    """Return the fields of `NormalEquations` of q errors after an update.

    Args:
        sums: before.
        information: (c, c) of the update, on these errors and others.
        score: (c,)
        first: index of the first of them.
    """
    own = slice(first, first + len(sums.score))
    information, score = sums.information + information[own, own], sums.score + score[own]
    values = solve(information, score)
    return information, score, values, float(score @ values)


NOTHING_LEFT = 1e-5
"""Part of its prior standard deviation that is left of an error that the model estimates."""
NOTHING = NormalEquations(np.empty((0, 0)), np.empty(0), np.empty(0), 0.0)
"""No errors that are tested beside."""
