"""Test whether the scale factor depends on the rate, or on the side of a turn.

Where it does, it seems to change with each turn. Where it does so little, its mean over the rates driven is
taken for the one at small rates, many standard deviations off. Each law has a column in the sensitivity X,
like a candidate effect (`ekf.history.score_statistics`): the innovations give its size theta, and X theta
is what it changes in bias and coefficients (Friedland 1969). The estimate does not follow; the shift adds
to the standard deviations. Where the camera has errors that are significant, a law is what they leave: the
rows of an image that are exposed one after the other look like a cubic.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.effects.scale_asymmetry import ScaleAsymmetry
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.state.layout import YAW_BIAS, State
from gyrocal_ros.ekf.state.normal_equations import (
    NOTHING_LEFT,
    NormalEquations,
    normal_equations,
)
from gyrocal_ros.ekf.state.positive_definite import inverse
from gyrocal_ros.ekf.watches.camera_watch import CameraWatch

RATES = 'the scale factor is not the same at all rates'
SIDES = 'the scale factor is not the same to both sides'
"""First words of the findings; the remedy follows after a semicolon."""
LAWS = (scale_power(3), RATES), (scale_power(2), SIDES), (ScaleAsymmetry(), SIDES)
"""Laws of one coefficient each, and what they are called."""
PRIOR_STD = np.array([law.coefficients[0].prior_std for law, _ in LAWS])
CHANCE_SIGMA, SIGNIFICANT_SIGMA = 3.0, 4.5
"""Significances from which a law is suspected, and from which it is certain. A shift is many times its
standard deviation where rates and sides of the turns are alike, while the law is not even certain."""
MOST_NIS, TINY = 3.0, 1e-9
"""NIS per degree of freedom beyond which an update counts as one of that NIS, and a number above zero."""
BLOCK_S, AGREED_SIGMA = 5.0, 2.0
"""Length of the blocks of time whose scores have to agree upon a law, and the significance of their sum by
their scatter: a bias that walks more than the filter expects makes them large, of either sign."""
SETTLE_S = 10.0
"""Time for which a law has to be certain before it is reported."""


class LawWatch:
    """Follows the columns of `LAWS` in the sensitivity.

    Args:
        first: index of the first of them.
        estimated: names of the effects that the model has: it estimates these laws itself.
        camera: the test of the camera, which takes each step before this one; None without.
    """

    count = len(LAWS)
    """Number of the columns."""

    def __init__(
        self, first: int, estimated: Collection[str] = (), camera: CameraWatch | None = None
    ) -> None:
        self._camera = camera
        self._columns = slice(first, first + self.count)
        is_left = np.array([law.name not in estimated for law, _ in LAWS])
        self._prior_std = PRIOR_STD * np.where(is_left, 1.0, NOTHING_LEFT)
        self.restart()

    def restart(self) -> None:
        """Forget what was seen so far."""
        errors = np.empty(0) if self._camera is None else self._camera.prior_std
        self._information: Array = np.diag(np.concatenate([errors, self._prior_std]) ** -2.0)
        self._score: Array = np.zeros(len(self._information))
        """Sums for the errors of the camera and then the laws, see `NormalEquations`."""
        self.sums = self._of_laws()
        self._errors: Array | None = None
        self._by_camera: Array | None = None
        """(8,) errors of the camera, and (3, 8) how much less they are by each law; None without any."""
        self._nis, self._dof = 0.0, 0
        self._best, self._value, self._explained, self._is_agreed = 0, 0.0, 0.0, False
        """Place of the law that alone explains most, its value, its significance squared, and whether blocks
        agree."""
        self._block_s, self._squares = 0.0, np.zeros(self.count)
        """Age of the present block, and summed squares of the scores of blocks."""
        self._block_began: tuple[Array, Array] = self._information, self._score
        self._certain_s = 0.0

    def add(self, duration_s: float, updates: tuple[UpdateStats, ...]) -> None:
        """Add the updates of one step. Images of something else hardly count."""
        for stats in updates:
            if stats.information is None or stats.score is None:
                continue
            information, score = stats.information, stats.score
            weight = min(1.0, MOST_NIS * stats.dof / max(stats.nis, TINY))
            if weight < 1.0:
                information, score = weight * information, weight * score
            both = slice(self._columns.stop - len(self._score), self._columns.stop)
            self._information = self._information + information[both, both]
            self._score = self._score + score[both]
            self._nis += weight * stats.nis
            self._dof += stats.dof
        self.sums = self._of_laws()
        self._block_s += duration_s
        if self._block_s >= BLOCK_S:
            information_then, score_then = self._block_began
            left = self._left(self._information - information_then, self._score - score_then)
            self._squares, self._block_s = self._squares + left**2, 0.0
            self._block_began = self._information, self._score
        self._judge()

    def _of_laws(self) -> NormalEquations:
        """Return the sums for the laws alone."""
        own = slice(-self.count, None)
        return normal_equations(self._information[own, own], self._score[own])

    def _left(self, information: Array, score: Array) -> Array:
        """Return what significant errors of the camera leave of the scores (3,) of some time."""
        if self._errors is None:
            return score[-self.count :]
        left: Array = score[-self.count :] - information[-self.count :, : -self.count] @ self._errors
        return left

    def _judge(self) -> None:
        """Find the law that alone explains most, and its significance, beside the errors of the camera."""
        known = self._information.diagonal()[-self.count :]
        self._errors = self._by_camera = None
        if self._camera is not None and self._camera.is_significant:
            # The Schur complement: law and camera are estimated together.
            before, cross = slice(-self.count), self._information[-self.count :, : -self.count]
            covariance = inverse(self._information[before, before])
            self._errors, self._by_camera = covariance @ self._score[before], cross @ covariance
            known = known - np.sum(self._by_camera * cross, axis=1)
        scores, information = self._left(self._information, self._score).tolist(), known.tolist()
        alone = [score**2 / part for score, part in zip(scores, information, strict=True)]
        explained = max(alone)
        left = max((self._nis - explained) / max(self._dof, 1), 1.0)
        best = self._best = alone.index(explained)
        self._value, self._explained = scores[best] / information[best], explained / left
        self._is_agreed = scores[best] ** 2 >= AGREED_SIGMA**2 * float(self._squares[best])

    @property
    def explained(self) -> float:
        """Part of the NIS that a significant law explains, relative to what is left; 0 without."""
        return self._explained if self._explained >= SIGNIFICANT_SIGMA**2 else 0.0

    def suspected_std(self, state: State) -> Array:
        """Return the standard deviations (1 + k,) of yaw bias and coefficients by the likeliest law."""
        best, chance = self._best, CHANCE_SIGMA**2
        if self._explained <= chance:
            return np.zeros(1 + state.coefficient_count)
        by_error = state.sensitivity[YAW_BIAS : state.robot_size]
        by_law = by_error[:, self._columns.start + best]
        if self._camera is not None and self._by_camera is not None:
            by_law = by_law - by_error[:, self._camera.columns] @ self._by_camera[best]
        std: Array = np.abs(by_law * self._value) * math.sqrt(1.0 - chance / self._explained)
        return std

    def finding(self, duration_s: float) -> str:
        """Return what is wrong, once it has been certain for `SETTLE_S`; empty otherwise.

        Args:
            duration_s: time since the last call.
        """
        self._certain_s = self._certain_s + duration_s if self.explained and self._is_agreed else 0.0
        if self._certain_s < SETTLE_S:
            return ''
        return f'{LAWS[self._best][1]} ({math.sqrt(self._explained):.0f} sigma); a diagnosis tells the law'
