"""A finished run as arrays, the input of all diagnosis and of every report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, IntArray, Rig, Span, TruthSample, seconds
from gyrocal_ros.ekf.history.feature_likelihoods import FeatureLikelihoodRecorder, FeatureLikelihoods
from gyrocal_ros.ekf.history.growing import GrowingColumn
from gyrocal_ros.ekf.history.score_statistics import ScoreRecorder, ScoreStatistics
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW_BIAS, State
from gyrocal_ros.model.sensor import Effect, SensorModel

TRUTH_INTERVAL_NS = 20_000_000
"""Shortest interval at which ground truth is kept."""
BLOCK_ROWS = 256
"""Number of steps that are moved to the columns of a history, or read from them, at once."""
VECTORS = ('mean', 'std', 'change', 'change_variance', 'suspected_std', 'columns')
"""Fields of `History` that hold several numbers a step, those of the same name in the record of the step."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """One row for each step of the filter, s steps."""

    t_ns: IntArray
    """(s,) stamps."""
    time_s: Array
    """(s,) time since the first step; steps of the clock do not count."""
    mean: Array
    """(s, 9 + k) robot part of the state, as laid out in `ekf.state.layout`."""
    std: Array
    """(s, 9 + k) its standard deviations."""
    change: Array
    """(s, 1 + k) change of yaw bias and coefficients by the measurements of the step."""
    change_variance: Array
    """(s, 1 + k) decrease of their variances by them."""
    suspected_std: Array
    """(s, 1 + k) standard deviations of their errors by what is suspected of the camera and of a drift."""
    columns: Array
    """(s, k) derivative of the correction with respect to the coefficients."""
    signals: Array
    """(s, q) other recorded numbers at the end of each step, NaN before their first."""
    nis: Array
    dof: Array
    """(s,) normalised innovation squared and degrees of freedom; zero where nothing was measured."""
    log_likelihood: Array
    """(s,) predictive log-likelihood of the measurements, zero-rate updates included."""
    used: Array
    rejected: Array
    dropped: Array
    on_lens: Array
    in_view: Array
    """(s,) numbers of features used, rejected, removed as not fixed in space, dropped by the tracker because
    they stay in the image, and in view; some of these have not moved since their last use."""
    heading_innovation_rad: Array
    """(s,) NaN where nothing was measured."""
    heading_innovation_std_rad: Array
    pixel_noise_px: Array
    stamp_noise_s: Array
    """(s,) noise of the stamps of images that is learned, see `ekf.noise.stamp_noise`."""
    waits: Array
    """(s,) 1 while coefficients wait for the camera to move, see `ekf.features.considered`: the filter is
    then optimal for no value of them, and its log-likelihood does not measure the model."""
    dt_s: Array
    turn_rad: Array
    """(s,) turn of the step by the nominal gyro, without bias and coefficients."""
    correction_rad: Array
    """(s,) correction of the turn by the coefficients after the step, without bias."""
    tilt_rad: Array
    """(s,) change of heading by rolling and pitching, beyond the turn about the body's own z axis."""
    gyro_valid_s: Array
    """(s,) time with a valid gyro reading; only then the bias acts."""
    unobserved_turn_std_rad: Array
    """(s,) standard deviation of the turn that the gyro could not read."""
    distance_m: Array
    temperature_c: Array
    forward_m_s2: Array
    """(s,) mean specific force along body x."""
    resting: Array
    """(s,) 1 where the wheels stood still, and the gyro did not contradict them."""
    gap_s: Array
    """(s,) time without IMU samples."""
    wheel_turn_rad: Array
    """(s,) turn of the step by the wheels."""
    scale_change: Array
    """(s,) significant change of the scale factor that the filter did not follow (`ekf.watches.scale_watch`);
    zero without one."""
    scale_followed: Array
    """(s,) 1 where the filter followed such a change."""
    bias_walk: Array
    """(s,) random walk of the bias that the filter expects, relative to the settings; more than 1 where it
    follows the bias because that walks by more, see `ekf.noise.noise_bank`."""

    @property
    def coefficients(self) -> Array:
        """(s, k)"""
        return self.mean[:, COEFFICIENTS_START:]

    def turned_rad(self, above_rad_s: float) -> tuple[float, float]:
        """Return the total turn to the left and to the right, bias taken off, in steps above a rate."""
        turn = self.turn_rad + self.mean[:, YAW_BIAS] * self.dt_s
        left, right = turn > above_rad_s * self.dt_s, turn < -above_rad_s * self.dt_s
        return float(turn[left].sum()), -float(turn[right].sum())


SCALARS: dict[str, Callable[[StepRecord], float]] = {
    'nis': lambda step: step.update.stats.nis,
    'dof': lambda step: step.update.stats.dof,
    'log_likelihood': lambda step: step.update.stats.log_likelihood + step.resting.log_likelihood,
    'used': lambda step: step.update.used,
    'rejected': lambda step: step.update.rejected,
    'dropped': lambda step: len(step.update.dropped_ids),
    'on_lens': lambda step: step.update.on_lens,
    'in_view': lambda step: step.update.used + step.update.rejected + step.update.unmoved,
    'heading_innovation_rad': lambda step: step.update.heading_rad if step.update.stats.dof else np.nan,
    'heading_innovation_std_rad': lambda step: (
        step.update.heading_std_rad if step.update.stats.dof else np.nan
    ),
    'pixel_noise_px': lambda step: step.pixel_noise_px,
    'stamp_noise_s': lambda step: step.stamp_noise_s,
    'waits': lambda step: step.update.waits,
    'dt_s': lambda step: step.block.duration_s,
    'turn_rad': lambda step: float(step.block.rate_rad_s[:, 2] @ step.block.dt_s),
    'correction_rad': lambda step: step.correction_rad,
    'tilt_rad': lambda step: step.tilt_rad,
    'gyro_valid_s': lambda step: step.gyro_valid_s,
    'unobserved_turn_std_rad': lambda step: step.unobserved_turn_std_rad,
    'distance_m': lambda step: step.block.distance_m.sum(),
    'temperature_c': lambda step: step.block.temperature_c[-1],
    'forward_m_s2': lambda step: (
        float(step.block.specific_force_m_s2[:, 0] @ step.block.dt_s) / step.block.duration_s
    ),
    'resting': lambda step: step.resting.dof > 0,
    'gap_s': lambda step: step.block.gap_s,
    'wheel_turn_rad': lambda step: step.block.wheel_turn_rad.sum(),
    'scale_change': lambda step: step.scale_change,
    'scale_followed': lambda step: step.scale_followed,
    'bias_walk': lambda step: step.bias_walk,
}
"""Fields of `History` that hold one number a step, and how each follows from the record of the step."""
COUNTS = ('dof', 'used', 'rejected', 'dropped', 'on_lens', 'in_view')
SMALL_COUNTS = ('waits', 'resting', 'scale_followed', 'bias_walk')
"""Those that are whole numbers, and those of them that are below a hundred."""
NOISES = ('pixel_noise_px', 'stamp_noise_s')
"""Those that need no more than single precision."""
_DTYPES: dict[str, type] = {
    **dict.fromkeys(COUNTS, np.int32),
    **dict.fromkeys(NOISES, np.float32),
    **dict.fromkeys(SMALL_COUNTS, np.int8),
}


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """Ground truth, in a frame of its own; only for comparison."""

    time_s: Array
    """(j,) on the time axis of the history."""
    position_m: Array
    """(j, 2)"""
    yaw_rad: Array
    """(j,) unwrapped."""


@dataclass(frozen=True, slots=True)
class RunEvent:
    """An event during the run that a person should know of."""

    t_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Result of one pass of the filter over one source."""

    source: str
    span: Span
    rig: Rig
    config: Config
    model: SensorModel
    history: History
    state: State
    """The final state, with the map."""
    truth: GroundTruth | None
    events: tuple[RunEvent, ...]
    scores: ScoreStatistics | None = None
    """Score statistics of the candidate effects, where there were any."""
    signal_names: tuple[str, ...] = ()
    """Names of the q other recorded numbers of the history."""
    features: FeatureLikelihoods | None = None
    """Features that the steps have used, for the comparison of models."""
    unfollowed_walk: float = 1.0
    """Random walk of the bias, relative to the settings, that is certain and was not followed."""

    def signal(self, name: str) -> Array:
        """Return one of the other recorded numbers (s,)."""
        return self.history.signals[:, self.signal_names.index(name)]


class Recorder:
    """Collects the steps of a run in memory that grows by some 450 bytes a step.

    Args:
        coefficient_count: k.
        candidates: effects that the model lacks.
        keeps_features: True to keep what the comparison of models takes: 16 bytes more for each feature.
    """

    def __init__(
        self, coefficient_count: int, candidates: tuple[Effect, ...] = (), *, keeps_features: bool = False
    ) -> None:
        self._scores = ScoreRecorder(candidates) if candidates else None
        self._features = FeatureLikelihoodRecorder() if keeps_features else None
        robot, learned = COEFFICIENTS_START + coefficient_count, 1 + coefficient_count
        widths = dict(zip(VECTORS, (robot, robot, learned, learned, learned, coefficient_count), strict=True))
        ends = np.cumsum([0, *widths.values()]).tolist()
        self._places: dict[str, int | slice] = {
            name: slice(*ends) for name, ends in zip(VECTORS, pairwise(ends), strict=True)
        }
        self._places |= {name: ends[-1] + i for i, name in enumerate(('time_s', *SCALARS))}
        self._columns = {name: GrowingColumn((width,)) for name, width in widths.items()}
        self._columns |= {
            name: GrowingColumn(dtype=_DTYPES.get(name, float)) for name in ('time_s', *SCALARS)
        }
        self._block, self._filled = np.empty((BLOCK_ROWS, ends[-1] + 1 + len(SCALARS))), 0
        self._t_ns = GrowingColumn(dtype=np.int64)
        self._signals: dict[str, GrowingColumn] = {}
        self._truth_ns, self._truth = GrowingColumn(dtype=np.int64), GrowingColumn((3,))
        self._first_ns: int | None = None
        self._last_truth_ns, self._last_truth_yaw_rad, self._unwrap_rad = -math.inf, math.nan, 0.0
        self._events: list[RunEvent] = []
        self._stepped_ns = 0

    def running_ns(self, t_ns: int) -> int:
        """Return a stamp on the time axis of the first clock."""
        return t_ns - self._stepped_ns

    def add(self, record: StepRecord) -> None:
        """Add one step of the filter."""
        running_ns = self.running_ns(record.t_ns)
        if self._first_ns is None:
            self._first_ns = running_ns
        since_ns = running_ns - self._first_ns
        scalars = [since_ns / NS_PER_S, *(read(record) for read in SCALARS.values())]
        vectors = [getattr(record, name) for name in VECTORS]
        np.concatenate([*vectors, scalars], out=self._block[self._filled])
        self._filled += 1
        if self._filled == BLOCK_ROWS:
            self._move_block()
        for name, values in record.block.covariates.items():
            if name not in self._signals:
                self._signals[name] = GrowingColumn()
            column = self._signals[name]
            column.pad(len(self._t_ns))
            column.append(values[-1])
        if self._features:
            self._features.add(len(self._t_ns), record.update)
        self._t_ns.append(record.t_ns)
        if record.event:
            self._events.append(RunEvent(record.t_ns, record.event))
        if self._scores:
            update = record.update
            self._scores.add(since_ns, (record.resting, update.stats), update.by_feature)

    def _move_block(self) -> None:
        """Move the rows collected so far to the columns."""
        rows = self._block[: self._filled]
        for name, column in self._columns.items():
            column.extend(rows[:, self._places[name]])
        self._filled = 0

    def add_truth(self, sample: TruthSample) -> None:
        """Add one pose of the ground truth."""
        t_ns = self.running_ns(sample.t_ns)
        if t_ns - self._last_truth_ns >= TRUTH_INTERVAL_NS:
            step_rad = sample.yaw_rad - self._last_truth_yaw_rad
            if abs(step_rad) >= math.pi:  # as numpy.unwrap, which needs several arrays of all poses
                self._unwrap_rad += (step_rad + math.pi) % math.tau - math.pi - step_rad
            self._last_truth_ns, self._last_truth_yaw_rad = t_ns, sample.yaw_rad
            self._truth_ns.append(t_ns)
            self._truth.append(np.array([*sample.position_m[:2], sample.yaw_rad + self._unwrap_rad]))

    def add_clock_step(self, step: ClockStep) -> None:
        """Add a step of the clock: all later stamps are on the new time base."""
        self._stepped_ns += step.step_ns
        text = f'the clock stepped by {seconds(step.step_ns):+.1f} s; pose and map were restarted'
        self._events.append(RunEvent(step.t_ns, text))

    @property
    def events(self) -> tuple[RunEvent, ...]:
        """Events so far."""
        return tuple(self._events)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the other recorded numbers so far."""
        return tuple(self._signals)

    def history(self) -> History:
        """Return all steps so far."""
        self._move_block()
        for column in self._signals.values():
            column.pad(len(self._t_ns))  # one may have ended early, after a step of the clock
        return History(
            t_ns=self._t_ns.rows(),
            signals=np.array([column.rows() for column in self._signals.values()]).T,
            **{name: column.rows() for name, column in self._columns.items()},
        )

    def scores(self) -> ScoreStatistics | None:
        """Return the score statistics of the candidates so far; None without candidates."""
        return self._scores.scores() if self._scores else None

    def features(self) -> FeatureLikelihoods | None:
        """Return the features used so far; None where they are not kept."""
        return self._features.likelihoods() if self._features else None

    def truth(self) -> GroundTruth | None:
        """Return the ground truth so far; None without any."""
        if len(self._truth_ns) < 2 or self._first_ns is None:
            return None
        poses = self._truth.rows()
        time_s = (self._truth_ns.rows() - self._first_ns) / NS_PER_S
        return GroundTruth(time_s, poses[:, :2], poses[:, 2])


def step_by_step(*columns: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Yield the numbers of columns (s,) step by step, as plain numbers, without a list of them all."""
    for first in range(0, len(columns[0]), BLOCK_ROWS):
        block = slice(first, first + BLOCK_ROWS)
        yield from zip(*(column[block].tolist() for column in columns), strict=True)
