"""Test whether the scale factor has changed: a stored calibration that is wrong, a drift, a jump.

The generalised likelihood ratio test of Willsky and Jones 1976. Columns of the sensitivity X start as a
change of the scale factor at some moment and go on with the filter: nu(delta) = nu(0) - G delta is the
innovation, had the scale factor changed by delta at that moment. Sums of G^T S^-1 G and G^T S^-1 nu give the
change, its standard deviation and its significance. Where it is significant, the state and the covariance
follow in closed form, as if the scale factor had been unknown at that moment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.ekf.state import COEFFICIENTS_START, State
from gyrocal_ros.ekf.update import MeasurementUpdate, UpdateStats, add_lacking
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place

SCALE_CHANGED = 'off what was calibrated before'
"""Words in the event of a run."""
WINDOWS_S = (3.0, 8.0, 20.0, 50.0, 120.0)
"""Lengths of the windows, one column each: a jump shows in a short one, a slow drift in a long one."""
ABSORBED = 0.2
"""Part of a change that is left when the filter has corrected the rest by itself, as in the first turn."""
MAX_STD = 0.005
"""Standard deviation of a change from which its window holds part of a turn; without, it holds noise."""
CHANGE_SIGMA = 4.5
"""Significance from which a change is real."""
SETTLE_S = 3.0
"""Time for which a change has to be significant before it is followed. Windows that began before a jump
contradict it in part; in this time one that began after it, or just before, explains more than they do."""
JUMP_S = 20.0
"""Time in which a jump shows; what takes longer is a drift."""
DRIFT_MEMORY_S = 600.0
"""Time constant by which a random walk that was learned from repeated changes decays."""


@dataclass(frozen=True, slots=True)
class ScaleChanges:
    """Changes of the scale factor at the beginnings of the windows, as an effect that the model lacks.

    It adds nothing to the rate: the columns of its sensitivity are set by `ScaleWatch`.
    """

    name: str = 'scale_change'
    acts_on: Place = 'gyro'
    coefficients: tuple[Coefficient, ...] = tuple(
        Coefficient(f'change_{length_s:.0f}_s', '1', 0.1) for length_s in WINDOWS_S
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return no contribution."""
        size = len(block.dt_s)
        return GyroTerm(np.zeros(size), np.zeros((size, len(WINDOWS_S))))


@dataclass(frozen=True, slots=True)
class ScaleChange:
    """A significant change of the scale factor."""

    column: int
    """Place of its column in the sensitivity."""
    value: float
    std: float
    sigma: float
    """Significance."""

    def __str__(self) -> str:
        return (
            f'the scale factor is {100.0 * self.value:+.2g} % {SCALE_CHANGED} '
            f'({self.sigma:.0f} sigma), so that was dropped: another gyro, one that has changed, or an '
            'effect that the model lacks'
        )


class ScaleWatch:
    """Follows the columns of `ScaleChanges`, which are the last ones of the sensitivity.

    Args:
        state: initial state of the filter.
    """

    def __init__(self, state: State) -> None:
        self._first = state.sensitivity.shape[1] - len(WINDOWS_S)
        self._ages_s = np.zeros(len(WINDOWS_S))
        self._information, self._score = np.zeros(len(WINDOWS_S)), np.zeros(len(WINDOWS_S))
        self._nis, self._dof = np.zeros(len(WINDOWS_S)), np.zeros(len(WINDOWS_S))
        self._running_s = self._significant_s = 0.0
        self._unchanged_s, self._walk = math.inf, 0.0

    def walk(self, gyro: GyroConfig) -> GyroConfig:
        """Return settings with the random walk of the scale factor that repeated changes show."""
        return gyro if self._walk <= gyro.scale_walk else replace(gyro, scale_walk=self._walk)

    def begin(self, state: State) -> State:
        """Return the state with all windows beginning now."""
        return self._restarted(state, np.ones(len(WINDOWS_S), bool))

    def add(self, duration_s: float, updates: tuple[UpdateStats, ...]) -> ScaleChange | None:
        """Add the updates of one step; return the most significant change, None if none is significant.

        Innovations that a change does not explain count as noise: what contradicts the filter otherwise, such
        as images of something else, is no change of the scale factor.
        """
        for stats in updates:
            if stats.information is not None and stats.score is not None:
                self._information += np.diagonal(stats.information)[self._first :]
                self._score += stats.score[self._first :]
                self._nis += stats.nis
                self._dof += stats.dof
        self._ages_s += duration_s
        self._unchanged_s += duration_s
        self._running_s += duration_s
        self._significant_s += duration_s if self._significant_s > 0.0 else 0.0
        self._walk *= math.exp(-0.5 * duration_s / DRIFT_MEMORY_S)
        information = np.maximum(self._information, np.finfo(float).tiny)
        explained = self._score**2 / information
        unexplained = (self._nis - explained) / np.maximum(self._dof, 1.0)
        sigmas = np.sqrt(explained / np.maximum(unexplained, 1.0))
        sigmas[information < 1.0 / MAX_STD**2] = 0.0
        best = int(sigmas.argmax())
        if sigmas[best] < CHANGE_SIGMA:
            self._significant_s = 0.0
            return None
        self._significant_s = self._significant_s or duration_s
        return ScaleChange(
            column=self._first + best,
            value=float(self._score[best] / information[best]),
            std=float(math.sqrt(max(unexplained[best], 1.0) / information[best])),
            sigma=float(sigmas[best]),
        )

    @property
    def is_settled(self) -> bool:
        """True if a change has been significant for long enough to be followed."""
        return self._significant_s >= SETTLE_S

    def renew(self, state: State) -> State:
        """Return the state where windows begin again that have ended, or say no more about the present."""
        if not state.coefficient_count:  # a model without a scale factor
            return state
        remaining = state.sensitivity[COEFFICIENTS_START, self._first :]
        ended = (self._ages_s >= WINDOWS_S) | (remaining < ABSORBED)
        return self._restarted(state, ended) if ended.any() else state

    def follow(self, state: State, change: ScaleChange) -> State:
        """Return the state as if the scale factor had been unknown at the beginning of the window.

        A change soon after another one, or one that shows only in a long window, is a drift, which the random
        walk then covers. One since the start is a calibration that was wrong.
        """
        window_s = float(self._ages_s[change.column - self._first])
        is_drift = JUMP_S < window_s < self._running_s
        drifting_s = min(self._unchanged_s, window_s if is_drift else math.inf)
        self._walk = max(self._walk, abs(change.value) / math.sqrt(max(drifting_s, SETTLE_S)))
        self._unchanged_s = self._significant_s = 0.0
        return self.begin(add_lacking(state, change.column, change.value, change.std))

    def without_changes(self, stats: UpdateStats) -> UpdateStats:
        """Return statistics of the candidates alone."""
        if stats.information is None or stats.score is None or self._first == 0:
            return replace(stats, information=None, score=None)
        kept = slice(self._first)
        return replace(stats, information=stats.information[kept, kept], score=stats.score[kept])

    def of_candidates(self, update: MeasurementUpdate) -> MeasurementUpdate:
        """Return an update with the statistics of the candidates alone."""
        return replace(update, stats=self.without_changes(update.stats))

    def _restarted(self, state: State, chosen: np.ndarray) -> State:
        columns = self._first + np.flatnonzero(chosen)
        sensitivity = state.sensitivity.copy()
        sensitivity[:, columns] = 0.0
        if state.coefficient_count:
            sensitivity[COEFFICIENTS_START, columns] = 1.0
        for sums in (self._ages_s, self._information, self._score, self._nis, self._dof):
            sums[chosen] = 0.0
        return replace(state, sensitivity=sensitivity)
