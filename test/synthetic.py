"""Score statistics, headings and runs made of numbers, for tests without a simulated recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, IntArray, Mount, Rig, Span
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, headings
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S, ScoreStatistics
from gyrocal_ros.ekf.state.layout import YAW, YAW_BIAS, State, no_landmarks
from gyrocal_ros.model.recording import GyroReadings, RecordingSummary
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.sim.scenarios import CAMERA

DT_S = 0.1
HEADING_STD_RAD = math.radians(0.05)
TOP_DEG_S = 90.0
RIG = Rig(CAMERA, Mount(np.eye(3), np.zeros(3)))


def score_statistics_of(columns: Array, seen: Array, candidates: tuple[Effect, ...] = ()) -> ScoreStatistics:
    """Return the statistics of B blocks of n measurements with unit noise.

    Args:
        columns: (B, n, c) sensitivities of the c coefficients.
        seen: (B, n) innovations.
        candidates: effects of the columns.
    """
    return ScoreStatistics(
        candidates=candidates,
        start_s=BLOCK_S * np.arange(len(seen)),
        information=np.einsum('bni,bnj->bij', columns, columns),
        score=np.einsum('bni,bn->bi', columns, seen),
    )


def turning_rad_s(duration_s: float) -> Array:
    """Return the yaw rate (s,) of a drive that turns 4 s in every 10 s, to both sides, up to the top rate."""
    time_s = DT_S * np.arange(1, round(duration_s / DT_S) + 1)
    speeds = np.radians([30.0, -45.0, 60.0, -75.0, TOP_DEG_S, -30.0, 45.0, -60.0, 75.0, -TOP_DEG_S])
    turning = (time_s % 10.0 > 3.0) & (time_s % 10.0 < 7.0)
    return np.where(turning, speeds[(time_s // 10.0).astype(int) % 10], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Filter output of a drive: the run, and the separate headings of gyro and camera."""

    run: Run
    seen: Headings


def drive(
    error_rad_s: Array | float = 0.0,
    *,
    duration_s: float = 300.0,
    gyro_noise: float = 1.0,
    seed: int = 0,
    signals: Mapping[str, Array] | None = None,
    read_rad_s: Array | None = None,
) -> Drive:
    """Return a drive whose gyro has an error.

    Args:
        error_rad_s: (s,) true rate minus the rate of the gyro.
        duration_s: duration of the drive.
        gyro_noise: factor of the gyro noise over the configured one.
        seed: seed of the noise.
        signals: (s,) other recorded signals by name.
        read_rad_s: (s,) gyro reading without noise and error; None for the true rate.
    """
    rng = np.random.default_rng(seed)
    true = turning_rad_s(duration_s)
    count, time_s = len(true), DT_S * np.arange(1, len(true) + 1)
    density = gyro_noise * math.radians(Config().gyro.rate_noise_deg_s)
    noise = density / math.sqrt(DT_S) * rng.normal(size=count)
    rate = (true if read_rad_s is None else read_rad_s) - error_rad_s + noise
    seen_rad = np.cumsum(true) * DT_S + HEADING_STD_RAD * rng.normal(size=count)
    zeros, model = np.zeros(count), default_model()
    mean = np.zeros((count, 10))
    mean[:, YAW] = seen_rad
    expected = np.concatenate([seen_rad[:1], seen_rad[:-1]]) + rate * DT_S
    history = History(
        t_ns=_ns(time_s),
        time_s=time_s - DT_S,
        mean=mean,
        std=np.zeros_like(mean),
        change=np.zeros((count, 2)),
        change_variance=np.zeros((count, 2)),
        suspected_std=np.zeros((count, 2)),
        nis=zeros,
        dof=np.ones(count),
        log_likelihood=zeros,
        used=np.full(count, 10.0),
        rejected=zeros,
        dropped=zeros,
        on_lens=zeros,
        in_view=np.ones(count),
        heading_innovation_rad=seen_rad - expected,
        heading_innovation_std_rad=np.full(count, HEADING_STD_RAD),
        pixel_noise_px=np.ones(count),
        stamp_noise_s=zeros,
        waits=zeros,
        dt_s=np.full(count, DT_S),
        turn_rad=rate * DT_S,
        correction_rad=zeros,
        tilt_rad=zeros,
        columns=(rate * DT_S)[:, None],
        gyro_valid_s=np.full(count, DT_S),
        unobserved_turn_std_rad=zeros,
        distance_m=np.where(np.abs(true) > 0.0, 0.0, 0.3 * DT_S),
        temperature_c=np.full(count, np.nan),
        forward_m_s2=zeros,
        resting=zeros,
        gap_s=zeros,
        wheel_turn_rad=true * DT_S,
        scale_change=zeros,
        scale_followed=zeros,
        bias_walk=np.ones_like(zeros),
        signals=np.array(list(signals.values())).T if signals else np.empty((count, 0)),
    )
    run = Run(
        source='synthetic',
        span=Span(0, int(history.t_ns[-1])),
        rig=RIG,
        config=Config(),
        model=model,
        history=history,
        state=State(int(history.t_ns[-1]), mean[-1], np.eye(10), 1, no_landmarks(), np.zeros((10, 0))),
        truth=None,
        events=(),
        signal_names=tuple(signals or ()),
    )
    return Drive(run, headings(run))


def banded(width_rad_s: float) -> Drive:
    """Make the run of a gyro with a dead band whose edge noise hides: at rest the bias does not show."""
    bias = 0.8 * width_rad_s
    made = drive(np.where(turning_rad_s(300.0) == 0.0, 0.0, bias))
    mean = made.run.history.mean.copy()
    mean[:, YAW_BIAS] = bias
    return replace(made, run=replace(made.run, history=replace(made.run.history, mean=mean)))


def readings(rate_rad_s: Array, hz: float = 1.0 / DT_S, *, start_s: float = 0.0) -> GyroReadings:
    """Stamp readings (n,) of the yaw rate."""
    return GyroReadings(_ns(start_s + np.arange(len(rate_rad_s)) / hz), rate_rad_s)


def readings_of(made: Drive) -> GyroReadings:
    """Return the readings that a drive was run on, one in the middle of each step."""
    history = made.run.history
    return readings(history.turn_rad / history.dt_s, start_s=0.5 * DT_S)


def recording_of(made: GyroReadings) -> RecordingSummary:
    """Summarise a recording that holds nothing but readings of the yaw rate."""
    duration_s = float(np.ptp(made.t_ns)) / NS_PER_S if len(made.t_ns) else 0.0
    return RecordingSummary(RIG, (), (), frozenset(), duration_s, made)


def _ns(time_s: Array) -> IntArray:
    return np.round(time_s * NS_PER_S).astype(np.int64)
