"""A finished run: everything that happened, as arrays. All criticism and every report reads this."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, IntArray, Rig, Span, TruthSample, seconds
from gyrocal_ros.ekf.score_statistics import ScoreRecorder, ScoreStatistics
from gyrocal_ros.ekf.slam import StepRecord
from gyrocal_ros.ekf.state import COEFFICIENTS_START, State
from gyrocal_ros.model.sensor import Effect, SensorModel

TRUTH_INTERVAL_NS = 20_000_000
"""Ground truth is kept no denser than this."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """One row a step of the filter, s steps."""

    t_ns: IntArray
    """(s,) stamps."""
    time_s: Array
    """(s,) since the first step; steps of the clock do not count."""
    mean: Array
    """(s, 9 + k) robot part of the state, as `ekf.state` lays it out."""
    std: Array
    """(s, 9 + k)"""
    nis: Array
    dof: Array
    """(s,) zero where nothing was measured."""
    log_likelihood: Array
    """(s,) of what was measured, standing still counted in, as it was expected before."""
    used: Array
    rejected: Array
    heading_innovation_rad: Array
    """(s,) NaN where nothing was measured."""
    heading_innovation_std_rad: Array
    pixel_noise_px: Array
    dt_s: Array
    turn_rad: Array
    """(s,) turn of the step by the nominal gyro, bias and coefficients not applied."""
    correction_rad: Array
    """(s,) what the coefficients of that moment added to it, the bias not counted."""
    tilt_rad: Array
    """(s,) what rolling and pitching added: the heading turns by more than a gyro that leans feels."""
    columns: Array
    """(s, k) derivative of the correction with respect to the coefficients."""
    gyro_valid_s: Array
    """(s,) how long the gyro was not blind: only there the bias counts."""
    unobserved_turn_std_rad: Array
    """(s,) standard deviation of the turn that an effect could not tell."""
    distance_m: Array
    temperature_c: Array
    forward_m_s2: Array
    """(s,) mean specific force along body x."""
    resting: Array
    """(s,) 1 where the wheels stood still."""
    gap_s: Array
    """(s,) time for which no IMU sample vouches."""
    signals: Array
    """(s, q) the other recorded numbers at the end of each step, NaN before their first."""

    @property
    def coefficients(self) -> Array:
        """(s, k)"""
        return self.mean[:, COEFFICIENTS_START:]


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """Ground truth, in a frame of its own. Only ever compared with."""

    time_s: Array
    """(j,) on the time axis of the history."""
    position_m: Array
    """(j, 3)"""
    yaw_rad: Array
    """(j,) unwrapped."""


@dataclass(frozen=True, slots=True)
class RunEvent:
    """Something that happened during the run and that a person should know."""

    t_ns: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What one pass of the filter over one source leaves behind."""

    source: str
    span: Span
    rig: Rig
    config: Config
    model: SensorModel
    history: History
    state: State
    """The last one, with the map."""
    truth: GroundTruth | None
    events: tuple[RunEvent, ...]
    scores: ScoreStatistics | None = None
    """Of effects that the model lacks, where some were on trial."""
    signal_names: tuple[str, ...] = ()
    """Of the q other recorded numbers of the history."""

    def signal(self, name: str) -> Array:
        """(s,) one of the other recorded numbers."""
        return self.history.signals[:, self.signal_names.index(name)]


class Recorder:
    """Gathers the steps of a run in memory that grows by some 300 bytes a step."""

    def __init__(self, coefficient_count: int, candidates: tuple[Effect, ...] = ()) -> None:
        self._count = coefficient_count
        self._evidence = ScoreRecorder(candidates) if candidates else None
        self._t_ns: list[int] = []
        self._times_ns: list[int] = []
        self._rows = np.empty((1024, 2 * COEFFICIENTS_START + 3 * coefficient_count + 19))
        self._signals: dict[str, list[float]] = {}
        self._truth_ns: list[int] = []
        self._truth: list[tuple[float, float, float, float]] = []
        self._events: list[RunEvent] = []
        self._stepped_ns = 0

    def running_ns(self, t_ns: int) -> int:
        """A stamp on the time axis of the first clock."""
        return t_ns - self._stepped_ns

    def add(self, record: StepRecord) -> None:
        """Take in one step of the filter."""
        if len(self._times_ns) == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        block, image = record.block, record.image
        measured = image.lesson.dof > 0
        self._rows[len(self._times_ns)] = np.concatenate(
            [
                record.mean,
                record.std,
                record.columns,
                (
                    image.lesson.nis,
                    image.lesson.dof,
                    image.lesson.log_likelihood + record.resting.log_likelihood,
                    image.used,
                    image.rejected,
                    image.heading_rad if measured else np.nan,
                    image.heading_std_rad if measured else np.nan,
                    record.pixel_noise_px,
                    block.duration_s,
                    block.rate_rad_s[:, 2] @ block.dt_s,
                    record.correction_rad,
                    record.tilt_rad,
                    record.gyro_valid_s,
                    record.unobserved_turn_std_rad,
                    block.distance_m.sum(),
                    block.temperature_c[-1],
                    block.specific_force_m_s2[:, 0] @ block.dt_s / block.duration_s,
                    block.wheels_at_rest,
                    block.gap_s,
                ),
            ]
        )
        for name, values in block.covariates.items():
            column = self._signals.setdefault(name, [])
            column.extend([np.nan] * (len(self._t_ns) - len(column)))
            column.append(values[-1])
        self._t_ns.append(record.t_ns)
        self._times_ns.append(self.running_ns(record.t_ns))
        if record.event:
            self._events.append(RunEvent(record.t_ns, record.event))
        if self._evidence:
            self._evidence.add(self._times_ns[-1] - self._times_ns[0], (record.resting, image.lesson))

    def add_truth(self, sample: TruthSample) -> None:
        """Take in one pose of the ground truth."""
        t_ns = self.running_ns(sample.t_ns)
        if not self._truth_ns or t_ns - self._truth_ns[-1] >= TRUTH_INTERVAL_NS:
            self._truth_ns.append(t_ns)
            self._truth.append((*sample.position_m, sample.yaw_rad))

    def add_clock_step(self, step: ClockStep) -> None:
        """Take in that the clock of the stamps has stepped: what follows is on the new one."""
        self._stepped_ns += step.step_ns
        text = f'the clock stepped by {seconds(step.step_ns):+.1f} s; pose and map were begun anew'
        self._events.append(RunEvent(step.t_ns, text))

    @property
    def events(self) -> tuple[RunEvent, ...]:
        """What happened so far."""
        return tuple(self._events)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Of the other recorded numbers so far."""
        return tuple(self._signals)

    def history(self) -> History:
        """All steps so far."""
        rows = self._rows[: len(self._times_ns)].copy()
        r = COEFFICIENTS_START + self._count
        mean, std, columns = rows[:, :r], rows[:, r : 2 * r], rows[:, 2 * r : 2 * r + self._count]
        scalars = rows[:, 2 * r + self._count :].T
        return History(
            t_ns=np.array(self._t_ns, np.int64),
            time_s=_since_first(self._times_ns, self._times_ns),
            mean=mean,
            std=std,
            columns=columns,
            nis=scalars[0],
            dof=scalars[1],
            log_likelihood=scalars[2],
            used=scalars[3],
            rejected=scalars[4],
            heading_innovation_rad=scalars[5],
            heading_innovation_std_rad=scalars[6],
            pixel_noise_px=scalars[7],
            dt_s=scalars[8],
            turn_rad=scalars[9],
            correction_rad=scalars[10],
            tilt_rad=scalars[11],
            gyro_valid_s=scalars[12],
            unobserved_turn_std_rad=scalars[13],
            distance_m=scalars[14],
            temperature_c=scalars[15],
            forward_m_s2=scalars[16],
            resting=scalars[17],
            gap_s=scalars[18],
            signals=np.array([_filled(column, len(rows)) for column in self._signals.values()]).T,
        )

    def scores(self) -> ScoreStatistics | None:
        """Of the candidates so far, where there are any."""
        return self._evidence.scores() if self._evidence else None

    def truth(self) -> GroundTruth | None:
        """Ground truth so far, if any came."""
        if len(self._truth_ns) < 2 or not self._times_ns:
            return None
        poses = np.array(self._truth)
        time_s = _since_first(self._truth_ns, self._times_ns)
        return GroundTruth(time_s, poses[:, :3], np.unwrap(poses[:, 3]))


def _since_first(times_ns: list[int], steps_ns: list[int]) -> Array:
    """Seconds since the first step."""
    return (np.array(times_ns, np.int64) - steps_ns[0]) / NS_PER_S if steps_ns else np.empty(0)


def _filled(column: list[float], count: int) -> Array:
    """A column that may have ended early, after a step of the clock."""
    return np.array(column + [np.nan] * (count - len(column)))
