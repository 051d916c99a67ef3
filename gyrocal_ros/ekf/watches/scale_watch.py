"""Test whether the scale factor has changed: a stored calibration that is wrong, a drift, a jump.

The generalised likelihood ratio test of Willsky and Jones 1976. Columns of the sensitivity X start as a
change of the scale factor at some moment and go on with the filter: nu(delta) = nu(0) - G delta is the
innovation, had the scale factor changed by delta at that moment. Sums of G^T S^-1 G and G^T S^-1 nu give the
change, its standard deviation and its significance. Where it is significant, the state and the covariance
follow in closed form, as if the scale factor had been unknown at that moment. The last column is a ramp: the
scale factor changes at a constant rate since the beginning of its window. It shows slow drifts earlier, and
adds to the standard deviation; the state follows the steps only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array, changed
from gyrocal_ros.ekf.equations.update import UpdateStats, add_lacking
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, State
from gyrocal_ros.ekf.state.normal_equations import NOTHING, NormalEquations
from gyrocal_ros.ekf.state.positive_definite import inverse
from gyrocal_ros.ekf.watches.drift_suspicion import (
    CHANCE_SIGMA,
    DRIFT_MEMORY_S,
    DRIFT_STD,
    EXACT,
    JUMP_S,
    RAMP_S,
    FollowedChanges,
    HeadingErrors,
    Ramp,
    suspected_drift,
)
from gyrocal_ros.kernels import compiled

SCALE_CHANGED = 'off what was calibrated before'
"""Words in the event of a run."""
WINDOWS_S = (3.0, 8.0, 20.0, 50.0, 120.0)
"""Lengths of the windows, one column each: a jump shows in a short one, a slow drift in a long one."""
LENGTHS_S = *WINDOWS_S, RAMP_S
"""Lengths of the windows of all columns."""
COLUMNS, RAMP = len(LENGTHS_S), -1
"""Number of columns, and the place of the ramp."""
FASTEST_DRIFT = 0.02
"""Drift over `RAMP_S` beyond which a change was not one: within a single turn, steps look like ramps."""
ABSORBED = 0.2
"""Part of a change that is left when the filter has corrected the rest by itself, as in the first turn."""
LARGEST_CHANGE = 0.1
"""Change of the scale factor that a gyro may have, by age, temperature and exchange for another."""
MAX_STD = 0.005
"""Standard deviation of a change from which its window holds part of a turn; without, it holds noise."""
CHANGE_SIGMA = 4.5
"""Significance from which a change is real."""
NOTICED_S = 0.5
"""Time of measurements for which a change has to be significant before it counts: of all images of a drive, a
few that err alike may seem to show one."""
SETTLE_S = 3.0
"""Time of measurements for which a change has to be significant before it is followed. Windows that began
before a jump contradict it in part; in this time one that began after it, or just before, explains more than
they do. Darkness and rests tell nothing, so they do not count."""
TURNING_RAD_S, PATIENCE_S = math.radians(5.0), 3.0
"""Rate from which the robot turns, and time by which a change is followed later in a turn: until its end, the
turn so far is explained as well by a window that began within an earlier turn."""
MIN_TURN_RAD = 0.01
"""Smallest turn by which an error of the heading is divided."""
NOT_LINEAR = 0.1
"""Part of a change that may be wrong because the sensitivity is linear, and because features were rejected
and weighted as if nothing had changed."""
LARGEST_WALK = FASTEST_DRIFT / math.sqrt(RAMP_S)
"""Largest random walk (1/sqrt(s)) that is learned. What changes faster are jumps, followed one by one: a walk
that covers them would leave the scale factor unknown for hours after a loose contact."""

TINY = float(np.finfo(float).tiny)
NOT_SEPARABLE = 1e-9
"""Smallest share of the information on a change that is left beside other errors, against rounding."""


INFORMATION, SCORE, NIS, DOF = range(4)
CROSS = slice(4, None)
"""Columns of the sums of a `ScaleWatch`; the last ones hold the information together with other errors."""


@dataclass(frozen=True, slots=True)
class ScaleChange:
    """A significant change of the scale factor."""

    column: int
    """Place of its column in the sensitivity."""
    value: float
    std: float
    sigma: float
    """Significance."""
    was_calibrated: bool
    """True if the scale factor was known before; what matches of a first turn contradict is no news."""

    def __str__(self) -> str:
        """Return the event; other effects may look like a change of the scale factor."""
        causes = 'another gyro, one that has changed, or an effect that the model lacks'
        if abs(self.value) > LARGEST_CHANGE:
            causes = 'no gyro changes so much, so stamps may be wrong, or the model lacks an effect'
        return (
            f'the scale factor is {100.0 * self.value:+.2g} % {SCALE_CHANGED} ({self.sigma:.0f} sigma), so '
            f'that was dropped: {causes}; `gyrocal diagnose` of a recording tells which'
        )


class ScaleWatch:
    """Follows changes of the scale factor at the beginnings of the windows.

    Their columns are the last ones of the sensitivity. They act nowhere: what they are is set here.

    Args:
        state: initial state of the filter.
        others: number of columns before, of errors that are tested beside, as those of the camera.
        chance_drift_std: bound of a drift that chance explains, see `USUAL_DRIFT_STD`.
        known_std: standard deviation of a scale factor that is calibrated.
        is_stored: True if the first one is that of an earlier calibration.
    """

    def __init__(
        self,
        state: State,
        others: int = 0,
        chance_drift_std: float = DRIFT_STD,
        known_std: float = math.inf,
        *,
        is_stored: bool = False,
    ) -> None:
        self._chance_drift_std = chance_drift_std
        self._first = state.sensitivity.shape[1] - COLUMNS
        self._sums: Array = np.zeros((COLUMNS, CROSS.start + others))
        self._known_std, self._is_stored = known_std, is_stored
        self._was_calibrated, self._calibrated_s = np.full(COLUMNS, is_stored), 0.0
        self._ramp, self._ramp_variance, self._ramp_sigma = 0.0, math.inf, 0.0
        self._drift = 0.0
        self._running_s = self._turned_rad = self._significant_s = 0.0
        self._began: list[tuple[float, float]] = [(0.0, 0.0)] * COLUMNS
        """Time and turn at which each window began."""
        self._shifts = [0.0] * COLUMNS
        """Largest shift of the scale factor by errors of the camera since then."""
        self._is_turning = False
        self._errors = EXACT
        # The turn that the scale factor is from: that of an earlier calibration is not known, but large.
        self._calibrating_turn_rad = math.inf if is_stored else 0.0
        self._unchanged_s, self._walk = math.inf, 0.0
        self._followed = FollowedChanges()

    def walk(self, gyro: GyroConfig) -> GyroConfig:
        """Return settings with the random walk of the scale factor that repeated changes show."""
        return gyro if self._walk <= gyro.scale_walk else replace(gyro, scale_walk=self._walk)

    def begin(self, state: State) -> State:
        """Return the state with all windows beginning now."""
        return self._restarted(state, np.ones(COLUMNS, bool))

    def add(
        self,
        duration_s: float,
        updates: tuple[UpdateStats, ...],
        others: Sequence[NormalEquations] = (),
        turned_rad: float = 0.0,
        errors: HeadingErrors = EXACT,
        shift: float = 0.0,
    ) -> ScaleChange | None:
        """Add the updates of one step; return the most significant change, None before it is noticed.

        Innovations that a change does not explain count as noise: what contradicts the filter otherwise, such
        as images of something else, is no change of the scale factor. Nor is an error of a heading that
        images of a turn have in common: it makes a change that is the smaller, the more has been turned. What
        an error of the camera shifts now, and has shifted differently before, seems to change as well.

        Args:
            duration_s: length of the step.
            updates: its updates, the last one by the image or the heading.
            others: groups of errors that are tested beside, in the order of their columns.
            turned_rad: by how much the robot has turned to the left in the step.
            errors: of the headings.
            shift: of the scale factor, by errors of the camera that are certain.
        """
        is_measured, side_rad, turned_rad = bool(updates and updates[-1].dof), turned_rad, abs(turned_rad)
        for stats in updates:
            if stats.information is not None and stats.score is not None:
                self._sums = scores_added(
                    self._sums, stats.information, stats.score, stats.nis, stats.dof, self._first
                )
        self._errors = errors
        if shift:
            self._shifts = [max(shifted, abs(shift)) for shifted in self._shifts]
        self._turned_rad += turned_rad
        self._calibrating_turn_rad += turned_rad
        self._is_turning = turned_rad > TURNING_RAD_S * duration_s
        self._unchanged_s += duration_s
        self._running_s += duration_s
        self._significant_s += duration_s if is_measured and self._significant_s > 0.0 else 0.0
        self._walk *= math.exp(-0.5 * duration_s / DRIFT_MEMORY_S)
        self._followed = self._followed.after(duration_s, side_rad if is_measured else 0.0)
        values, variances, sigmas = self._changes(others)
        self._ramp, self._ramp_variance = values.item(RAMP), variances.item(RAMP)
        self._ramp_sigma = sigmas.item(RAMP)
        sigma = beside = max(sigmas.tolist()[:RAMP])
        if sigma >= CHANGE_SIGMA:
            turned = [max(self._turned_since(column), MIN_TURN_RAD) for column in range(COLUMNS)]
            repeated = (errors.repeated_rad / np.array(turned)) ** 2
            sigmas, variances = sigmas / np.sqrt(1.0 + repeated / variances), variances + repeated
            sigma, shifted = max(sigmas.tolist()[:RAMP]), np.array(self._shifts) ** 2
            beside = max((sigmas / np.sqrt(1.0 + shifted / variances)).tolist()[:RAMP])
        if beside < CHANGE_SIGMA:
            self._significant_s = 0.0
            return None
        self._significant_s = self._significant_s or duration_s
        if self._significant_s < NOTICED_S:
            return None
        best = int(sigmas[:RAMP].argmax())
        std, was_calibrated = math.sqrt(variances[best]), bool(self._was_calibrated[best])
        return ScaleChange(self._first + best, float(values[best]), std, sigma, was_calibrated)

    def _changes(self, others: Sequence[NormalEquations]) -> tuple[Array, Array, Array]:
        """Return the changes, as `scale_changes`, beside the group of errors that leaves least of them."""
        grown, first, found = self._age_s(RAMP) / RAMP_S, 0, []
        for group in others or (NOTHING,):
            found.append(scale_changes(self._sums, group, first, MAX_STD**-2.0, grown))
            first += len(group.score)
        return min(found, key=lambda changes: max(changes[2].tolist()[:RAMP]))

    def _age_s(self, column: int) -> float:
        """Return the time since the beginning of a window."""
        return self._running_s - self._began[column][0]

    def _turned_since(self, column: int) -> float:
        """Return the turn (rad), to both sides, since the beginning of a window."""
        return self._turned_rad - self._began[column][1]

    @property
    def is_settled(self) -> bool:
        """True if a change has been significant for long enough to be followed."""
        return self._significant_s >= SETTLE_S + (PATIENCE_S if self._is_turning else 0.0)

    def suspected_std(self, state: State) -> float:
        """Return what adds to the deviation of the scale factor: a drift, slow errors, a next change."""
        age_s, turned_rad = self._age_s(RAMP), self._turned_since(RAMP)
        ramp = Ramp(self._ramp, self._ramp_variance, self._ramp_sigma, age_s, turned_rad)
        drift = suspected_drift(ramp, self._errors, self._chance_drift_std, self._drift)
        by_errors = self._errors.slow_rad / max(self._calibrating_turn_rad, MIN_TURN_RAD)
        by_ramp = drift * float(state.sensitivity[COEFFICIENTS_START, RAMP])
        return math.hypot(by_ramp, by_errors, self._followed.std)

    def renew(self, state: State, duration_s: float) -> State:
        """Return the state where windows begin again that have ended, or say no more about the present.

        Args:
            state: after a step.
            duration_s: length of the step, in which the ramp has grown.
        """
        if not state.coefficient_count:  # a model without a scale factor
            return state
        is_known = state.covariance[COEFFICIENTS_START, COEFFICIENTS_START] < self._known_std**2
        self._calibrated_s = self._calibrated_s + duration_s if is_known else 0.0
        ended = self._ended(state)
        if self._significant_s > 0.0 and not self.is_settled:
            ended = [False] * COLUMNS  # the window that explains a change has to last until it is followed
        if ended[RAMP]:
            self._drift = 0.0
        if any(ended):
            state = self._restarted(state, np.array(ended))
        sensitivity = state.sensitivity.copy()
        sensitivity[COEFFICIENTS_START, RAMP] += duration_s / RAMP_S
        return changed(state, sensitivity=sensitivity)

    def _ended(self, state: State) -> list[bool]:
        """Return which windows have ended, or are those of a change that the filter has corrected."""
        remaining = state.sensitivity[COEFFICIENTS_START, self._first :].tolist()
        remaining[RAMP] = 1.0  # a ramp begins with nothing
        return [
            self._running_s - began_s >= length_s or part < ABSORBED
            for (began_s, _), length_s, part in zip(self._began, LENGTHS_S, remaining, strict=True)
        ]

    def follow(self, state: State, change: ScaleChange) -> State:
        """Return the state as if the scale factor had been unknown at the beginning of the window.

        A change soon after another one, or one that shows only in a long window, is a drift, which the random
        walk then covers. One since the start is a calibration that was wrong. One that a ramp explains
        as well may go on, until a new ramp shows that it does not. A first estimate that was wrong, as the
        map of the first turns may be, is neither.
        """
        window_s = self._age_s(change.column - self._first)
        is_drift = JUMP_S < window_s < self._running_s
        drifting_s = min(self._unchanged_s, window_s if is_drift else math.inf)
        walk = abs(change.value) / math.sqrt(max(drifting_s, SETTLE_S))
        if change.was_calibrated:
            self._walk = max(self._walk, min(walk, LARGEST_WALK))
        is_ramp = change.was_calibrated and self._ramp_sigma**2 > change.sigma**2 - CHANCE_SIGMA**2
        self._drift = abs(self._ramp) if is_ramp and abs(self._ramp) < FASTEST_DRIFT else 0.0
        self._unchanged_s = self._significant_s = 0.0
        self._calibrating_turn_rad = self._turned_since(change.column - self._first)
        if change.was_calibrated or self._followed.count:
            self._followed = self._followed.with_one(change.value, is_stored=self._is_stored)
        self._is_stored = False
        std = math.hypot(change.std, NOT_LINEAR * change.value)
        return self.begin(add_lacking(state, change.column, change.value, std))

    def _restarted(self, state: State, chosen: np.ndarray) -> State:
        columns = self._first + chosen.nonzero()[0]
        sensitivity = state.sensitivity.copy()
        sensitivity[:, columns] = 0.0
        if state.coefficient_count:
            sensitivity[COEFFICIENTS_START, columns] = 1.0
            if chosen[RAMP]:
                sensitivity[COEFFICIENTS_START, RAMP] = 0.0
        self._sums[chosen] = 0.0
        for column in chosen.nonzero()[0].tolist():
            self._began[column], self._shifts[column] = (self._running_s, self._turned_rad), 0.0
        self._was_calibrated[chosen] = self._is_stored or self._calibrated_s > SETTLE_S
        return changed(state, sensitivity=sensitivity)


@compiled
def scores_added(sums: Array, information: Array, score: Array, nis: float, dof: int, first: int) -> Array:
    """Return the sums (q, 4 + p) of `ScaleWatch` with those of an update.

    Args:
        sums: before.
        information: (c, c) of the update, on the p other errors and then the q changes last.
        score: (c,)
        nis: its normalised innovation squared.
        dof: its degrees of freedom.
        first: index of the first change.
    """
    added = np.zeros_like(sums)
    added[:, INFORMATION], added[:, SCORE] = information.diagonal()[first:], score[first:]
    added[:, NIS], added[:, DOF] = nis, dof
    added[:, CROSS] = information[first:, first + CROSS.start - sums.shape[1] : first]
    return sums + added


@compiled
def scale_changes(
    sums: Array, others: NormalEquations, first: int, least: float, grown: float
) -> tuple[Array, Array, Array]:
    """Return q changes, each estimated alone, their variances and their significances in sigma, (q,) each.

    Args:
        sums: (q, 4 + p) as of `ScaleWatch`.
        others: a group of r of the p other errors. Where they explain the innovations better than any change,
            more than by chance, only what they do not explain can be a change.
        first: index of the first of them.
        least: information on a change below which nothing is significant.
        grown: part of one to which the last change, a ramp, has grown; it counts as what it is so far.

    Raises:
        FilterDivergedError: the information on the other errors is not positive definite.
    """
    information, score = sums[:, INFORMATION], sums[:, SCORE]
    cross = sums[:, CROSS][:, first : first + len(others.score)]
    least_each = np.full(len(sums), least)
    least_each[RAMP] *= grown**2
    information = np.maximum(information, TINY)
    explained = score**2 / information
    if others.explained - len(others.score) > explained.max():
        # The Schur complement: change and other errors are estimated together.
        by_others = cross @ inverse(others.information)
        left = information - np.sum(by_others * cross, axis=1)
        information = np.maximum(left, NOT_SEPARABLE * information)
        score = score - by_others @ others.score
        explained = score**2 / information
    with np.errstate(over='ignore'):  # the variance of what nothing is known of is infinite
        variances = np.maximum((sums[:, NIS] - explained) / np.maximum(sums[:, DOF], 1.0), 1.0)
        variances /= information
    values = score / information
    return values, variances, np.where(information < least_each, 0.0, np.abs(values) / np.sqrt(variances))
