"""Test whether the camera differs from its calibration: wrong distortion, or a tilt.

A wrong lens hides behind a larger pixel noise and shifts the scale factor. Errors of the camera have columns
in the sensitivity X, like a candidate effect (`ekf.score_statistics`): the innovations give the errors theta,
and X theta is what they change in bias and coefficients (Friedland 1969). The estimate does not follow; while
an error is significant, this shift adds to the standard deviations.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.camera_tilt import CameraTilt
from gyrocal_ros.effects.radial_distortion import RadialDistortion
from gyrocal_ros.ekf.scale_watch import NormalEquations, equations_added, normal_equations
from gyrocal_ros.ekf.state import COEFFICIENTS_START, YAW_BIAS, State
from gyrocal_ros.ekf.update import UpdateStats
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.statistics import chi_square_quantile

CAMERA_ERRORS: tuple[Effect, ...] = (RadialDistortion(), CameraTilt())
"""Errors of the camera that are tested, as effects that the model lacks."""
LENS, TILT = slice(0, 2), slice(2, 4)
"""Their columns."""
CHANCE = 7e-6
"""Probability, by chance, of errors from which they are significant: 4.5 sigma."""
GATE = chi_square_quantile(1.0 - CHANCE, 4)
PRIOR_STD = np.array([item.prior_std for effect in CAMERA_ERRORS for item in effect.coefficients])
LENS_FAULT, TILT_FAULT = 'the distortion in camera_info', 'the camera looks'
"""First words of the findings; the remedy follows after a semicolon."""
SETTLE_S = 10.0
"""Time for which an error has to matter before it is reported."""


class CameraWatch:
    """Follows the columns of `CAMERA_ERRORS` in the sensitivity.

    Args:
        first: index of the first of them.
    """

    count = len(PRIOR_STD)
    """Number of the columns."""

    def __init__(self, first: int) -> None:
        self._columns = slice(first, first + self.count)
        self.restart()

    def restart(self) -> None:
        """Forget what was seen so far."""
        self.sums = normal_equations(np.diag(PRIOR_STD**-2.0), np.zeros(self.count))
        self._nis, self._dof = 0.0, 0
        self._matters_s = 0.0

    def add(self, updates: tuple[UpdateStats, ...]) -> None:
        """Add the updates of one step."""
        for stats in updates:
            if stats.information is not None and stats.score is not None:
                first = self._columns.start
                self.sums = NormalEquations(
                    *equations_added(self.sums, stats.information, stats.score, first)
                )
                self._nis += stats.nis
                self._dof += stats.dof

    @property
    def _is_significant(self) -> bool:
        return self._significance(self.sums.explained) >= GATE

    @property
    def errors(self) -> Array:
        """(4,) errors of the camera if they are significant, zero otherwise."""
        return self.sums.values if self._is_significant else np.zeros(self.count)

    def shift(self, state: State) -> Array:
        """Return by how much the errors change yaw bias and coefficients, (1 + k,)."""
        if not self._is_significant:
            return np.zeros(1 + state.coefficient_count)
        changes: Array = state.sensitivity[YAW_BIAS : state.robot_size, self._columns] @ self.errors
        return changes

    def finding(self, duration_s: float, state: State, shift: Array) -> str:
        """Return what is wrong with the camera, once that has mattered for `SETTLE_S`; empty otherwise.

        An error matters if it shifts the scale factor by more than its standard deviation.

        Args:
            duration_s: time since the last call.
            state: the state.
            shift: as returned by `shift`.
        """
        scale_variance = state.covariance[COEFFICIENTS_START, COEFFICIENTS_START]
        matters = len(shift) > 1 and shift[1] ** 2 > scale_variance
        self._matters_s = self._matters_s + duration_s if matters else 0.0
        if self._matters_s < SETTLE_S:
            return ''
        by_lens, by_tilt = (self._of(columns).explained for columns in (LENS, TILT))
        sigma = math.sqrt(self._significance(max(by_lens, by_tilt)))
        errors = self.errors
        if by_lens >= by_tilt:
            k1, k2 = errors[LENS]
            return (
                f'{LENS_FAULT} does not fit the images ({sigma:.0f} sigma): k1 {k1:+.2g}, '
                f'k2 {k2:+.2g} would fit better; calibrate the camera again'
            )
        tilt_deg = math.degrees(float(np.linalg.norm(errors[TILT])))
        return (
            f'{TILT_FAULT} {tilt_deg:.1f} deg beside the direction of its transform, or the principal '
            f'point in camera_info is wrong ({sigma:.0f} sigma); a diagnosis tells which, and by how much'
        )

    def _of(self, columns: slice) -> NormalEquations:
        return normal_equations(self.sums.information[columns, columns], self.sums.score[columns])

    def _significance(self, explained: float) -> float:
        """Return the explained part of the NIS by the part per degree of freedom that is left, 1 or more."""
        left = (self._nis - explained) / max(self._dof, 1)
        return explained / max(left, 1.0)


def camera_fault(event: str) -> tuple[str, str]:
    """Return the fault and the remedy of a finding in the text of an event, which may report others as well.

    Both are empty where there is none.
    """
    for first_words in (LENS_FAULT, TILT_FAULT):
        _, is_found, rest = event.partition(first_words)
        if is_found:
            fault, remedy, *_ = rest.split('; ')
            return f'{first_words}{fault}', remedy
    return '', ''
