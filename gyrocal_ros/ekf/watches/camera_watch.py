"""Test whether the camera differs from its calibration: the lens, the mounting, or the stamps of its images.

A wrong lens hides behind a larger pixel noise and shifts the scale factor. Where images and gyro are some
milliseconds apart, the scale factor seems to change with each turn. Errors of the camera have columns in
the sensitivity X, like a candidate effect (`ekf.history.score_statistics`): the innovations give the errors
theta, and X theta is what they change in bias and coefficients (Friedland 1969). The estimate does not
follow; while an error is significant, this shift adds to the standard deviations. Only the time between
images and gyro is followed, on the robot: without, no turn would be predicted well.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from itertools import pairwise

import numpy as np

from gyrocal_ros.data import Array, changed
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE, YAW_BIAS, State
from gyrocal_ros.ekf.state.normal_equations import (
    NOTHING_LEFT,
    NormalEquations,
    equations_added,
    normal_equations,
)
from gyrocal_ros.ekf.state.positive_definite import inverse
from gyrocal_ros.ekf.watches.camera_faults import CAMERA_ERRORS, changing_time_fault, time_fault
from gyrocal_ros.statistics import chi_square_quantile

SIGNIFICANT_SIGMA, CHANCE = 4.5, 7e-6
"""Significance from which an error is one, and its probability by chance."""
PRIOR_STD = np.array([item.prior_std for error in CAMERA_ERRORS for item in error.effect.coefficients])
GATE = chi_square_quantile(1.0 - CHANCE, len(PRIOR_STD))
COLUMNS = tuple(
    slice(*ends)
    for ends in pairwise(
        np.cumsum([0, *(len(error.effect.coefficients) for error in CAMERA_ERRORS)]).tolist()
    )
)
"""Those of each error."""
LENS_AND_TILT = 4
"""Number of the first columns, of errors that all features of an image have in common."""
TIME = len(PRIOR_STD) - 1
"""Column of the time between images and gyro."""
SETTLE_S = 10.0
"""Time for which an error has to matter before it is reported."""
SURE_S = 3.0
"""Time of measurements for which the time between images and gyro is significant before it is followed."""
CLOCK_WALK = 1e-4
"""Random walk of the time between images and gyro, s/sqrt(s): clocks drift apart by up to 300 ppm."""
CHANGES_TOLD = 3
"""Number of times between images and gyro, each another one, from which it changes."""
TOLD_S, TOLD_PART = 0.001, 0.2
"""Time between images and gyro from which an event tells it, and relative change until the next one."""


class CameraWatch:
    """Follows the columns of `CAMERA_ERRORS` in the sensitivity.

    Args:
        first: index of the first of them.
        estimated: names of the effects that the model has: it estimates these errors itself.
    """

    count = len(PRIOR_STD)
    """Number of the columns."""

    def __init__(self, first: int, estimated: Collection[str] = ()) -> None:
        self.columns = slice(first, first + self.count)
        self.prior_std = PRIOR_STD.copy()
        for error, columns in zip(CAMERA_ERRORS, COLUMNS, strict=True):
            if error.effect.name in estimated:
                self.prior_std[columns] *= NOTHING_LEFT
        self.time_offset_s = 0.0
        """Stamp minus true time of the images, as far as that is followed."""
        self.allowed_for = ''
        """What is followed, for the user."""
        self._told_s, self._sure_s, self._times_told = 0.0, 0.0, 0
        self.restart()

    def restart(self) -> None:
        """Forget what was seen so far."""
        self.sums = normal_equations(np.diag(self.prior_std**-2.0), np.zeros(self.count))
        self._nis, self._dof = 0.0, 0
        self._matters_s = 0.0

    def add(self, duration_s: float, updates: tuple[UpdateStats, ...]) -> None:
        """Add the updates of one step. Clocks whose offset is followed may drift apart further."""
        if self.time_offset_s:
            self.sums = _with_clock_walk(self.sums, CLOCK_WALK**2 * duration_s)
        for stats in updates:
            if stats.information is not None and stats.score is not None:
                first = self.columns.start
                self.sums = NormalEquations(
                    *equations_added(self.sums, stats.information, stats.score, first)
                )
                self._nis += stats.nis
                self._dof += stats.dof

    @property
    def is_significant(self) -> bool:
        """True if the camera differs from its calibration."""
        return self._significance(self.sums.explained) >= GATE

    @property
    def is_certain(self) -> bool:
        """True if that has mattered to the scale factor for `SETTLE_S`."""
        return self._matters_s >= SETTLE_S

    @property
    def explained(self) -> float:
        """Part of the NIS that significant errors explain, relative to what is left; 0 without."""
        return self._significance(self.sums.explained) if self.is_significant else 0.0

    @property
    def errors(self) -> Array:
        """(8,) errors of the camera if they are significant, zero otherwise."""
        return self.sums.values if self.is_significant else np.zeros(self.count)

    def shift(self, state: State) -> Array | None:
        """Return by how much the errors change yaw bias and coefficients, (1 + k,); None without errors."""
        if not self.is_significant:
            return None
        changes: Array = state.sensitivity[YAW_BIAS : state.robot_size, self.columns] @ self.errors
        return changes

    def finding(self, duration_s: float, state: State, shift: Array | None) -> str:
        """Return what is wrong with the camera, once that has mattered for `SETTLE_S`; empty otherwise.

        An error matters if it shifts the scale factor by more than its standard deviation.

        Args:
            duration_s: time since the last call.
            state: the state.
            shift: as `shift` returns it.
        """
        matters = False
        if shift is not None and state.coefficient_count:
            matters = bool(shift[SCALE] ** 2 > state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])
        self._matters_s = self._matters_s + duration_s if matters else 0.0
        if not self.is_certain:
            return self.allowed_for
        alone = [
            normal_equations(self.sums.information[columns, columns], self.sums.score[columns])
            for columns in COLUMNS
        ]
        best = max(range(len(alone)), key=lambda i: alone[i].explained)
        sigma = math.sqrt(self._significance(alone[best].explained))
        return CAMERA_ERRORS[best].fault(alone[best].values, sigma)

    def with_time_offset(self, state: State, measured_s: float) -> tuple[State, bool]:
        """Follow the time between images and gyro once it is sure.

        The state becomes what it would be, had the images been used at their true times; so do the sums,
        which go on. Later images are to be used at the times by `time_offset_s`.

        Args:
            state: after the step.
            measured_s: length of the step if an image was used, else zero.

        Returns:
            The state, and True if it has changed.
        """
        value, std = self._time_offset() if self.is_significant else (0.0, math.inf)
        self._sure_s = self._sure_s + measured_s if abs(value) > SIGNIFICANT_SIGMA * std else 0.0
        if self._sure_s < SURE_S:
            return state, False
        self._sure_s = 0.0
        self.time_offset_s += value
        if abs(self.time_offset_s - self._told_s) > max(TOLD_S, TOLD_PART * abs(self._told_s)):
            self._told_s = self.time_offset_s
            is_told = abs(self.time_offset_s) > TOLD_S
            self._times_told += is_told
            fault = time_fault if self._times_told < CHANGES_TOLD else changing_time_fault
            told = fault(np.array([self.time_offset_s]), abs(value) / std)
            self.allowed_for = told if is_told else ''
        before = self.sums
        self.sums = normal_equations(before.information, before.score - value * before.information[:, TIME])
        self._nis -= before.explained - self.sums.explained
        followed = value * state.sensitivity[:, self.columns.start + TIME]
        return changed(state, mean=state.mean + followed), True

    def _time_offset(self) -> tuple[float, float]:
        """Return the time between images and gyro that is not followed yet, and its standard deviation."""
        variance = inverse(self.sums.information)[TIME, TIME]
        return float(self.sums.values[TIME]), math.sqrt(variance * self._left(self.sums.explained))

    def _significance(self, explained: float) -> float:
        """Return the explained part of the NIS by the part per degree of freedom that is left."""
        return explained / self._left(explained)

    def _left(self, explained: float) -> float:
        """Return the NIS per degree of freedom that is not explained, 1 or more."""
        return max((self._nis - explained) / max(self._dof, 1), 1.0)


def _with_clock_walk(sums: NormalEquations, variance_s2: float) -> NormalEquations:
    """Return the equations where the time between images and gyro has a further variance.

    The values stay: it is the information that decreases, by the matrix inversion lemma.
    """
    by_time = sums.information[TIME]
    lost = variance_s2 / (1.0 + variance_s2 * by_time[TIME])
    information = sums.information - lost * np.outer(by_time, by_time)
    score = sums.score - lost * sums.score[TIME] * by_time
    return NormalEquations(information, score, sums.values, float(score @ sums.values))
