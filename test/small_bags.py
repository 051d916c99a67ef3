"""Small recordings for tests, made of analytic values: no simulator, no random numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.data import (
    NS_PER_S,
    CameraIntrinsics,
    CovariateSample,
    FeatureObservations,
    ImuSample,
    Measurement,
    Mount,
    Rig,
    TemperatureSample,
    TruthSample,
    WheelSample,
    nanoseconds,
)

START_NS = 1_700_000_000 * NS_PER_S
CAMERA = CameraIntrinsics(64, 48, 30.0, 30.0, 31.5, 23.5, (0.01, -0.02, 0.001, 0.002, 0.003))
RIG = Rig(
    CAMERA, Mount(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.1, 0.0, 0.2]))
)
GRAVITY = 9.8


def yaw_rate(time_s: float) -> float:
    """Return a yaw rate (rad/s) with turns to both sides, after a second of rest."""
    return math.sin(time_s) if time_s > 1.0 else 0.0


def drive(duration_s: float = 10.0, start_ns: int = START_NS) -> list[Measurement]:
    """Return all measurements of a short drive, in the order of their stamps."""
    samples: list[Measurement] = []
    for t_ns, time_s in _times(duration_s, 100.0, 0.0, start_ns):
        samples.append(ImuSample(t_ns, (0.01, -0.02, yaw_rate(time_s)), (0.1, -0.2, GRAVITY)))
    for t_ns, time_s in _times(duration_s, 20.0, 0.001, start_ns):
        samples.append(WheelSample(t_ns, 0.25, yaw_rate(time_s)))
    for t_ns, time_s in _times(duration_s, 10.0, 0.002, start_ns):
        ids = np.arange(6) + int(time_s)
        pixels = np.column_stack([ids % 7 * 8.0 + time_s / 16.0, 40.0 - ids]).astype(np.float32)
        samples.append(FeatureObservations(t_ns, ids, pixels.astype(float)))
    for t_ns, time_s in _times(duration_s, 1.0, 0.003, start_ns):
        samples.append(TemperatureSample(t_ns, 25.0 + time_s))
    for t_ns, time_s in _times(duration_s, 5.0, 0.004, start_ns):
        samples.append(CovariateSample(t_ns, 'battery_state.voltage', 12.5))
        samples.append(CovariateSample(t_ns, 'battery_state.current', -0.5 - int(time_s) / 16.0))
    for t_ns, time_s in _times(duration_s, 20.0, 0.005, start_ns):
        samples.append(TruthSample(t_ns, (time_s, -time_s, 0.0), yaw_rate(time_s)))
    return sorted(samples, key=lambda sample: sample.t_ns)


def write(
    path: Path,
    samples: Iterable[Measurement] | None = None,
    rig: Rig = RIG,
    storage: Literal['mcap', 'sqlite3'] = 'mcap',
    namespace: str = '',
) -> Path:
    """Write a bag of the samples, by default those of `drive`."""
    with new_bag(path, storage, namespace=namespace) as bag:
        bag.write_rig(rig, START_NS)
        for sample in drive() if samples is None else samples:
            bag.write(sample)
    return path


def changed(
    samples: Iterable[Measurement], kind: type, change: Callable[[Measurement], Measurement | None]
) -> Iterator[Measurement]:
    """Yield the samples, those of one kind changed, or left out if `change` returns None."""
    for sample in samples:
        new = change(sample) if isinstance(sample, kind) else sample
        if new is not None:
            yield new


def turned_imu(samples: Iterable[Measurement], R_ib: np.ndarray) -> Iterator[Measurement]:
    """Yield the samples as recorded by an IMU in a rotated mounting."""
    for sample in samples:
        if isinstance(sample, ImuSample):
            rate, force = R_ib @ sample.rate_rad_s, R_ib @ sample.specific_force_m_s2
            sample = replace(sample, rate_rad_s=tuple(rate), specific_force_m_s2=tuple(force))
        yield sample


def _times(duration_s: float, rate_hz: float, phase_s: float, start_ns: int) -> Iterator[tuple[int, float]]:
    for index in range(int(duration_s * rate_hz)):
        time_s = phase_s + index / rate_hz
        yield start_ns + nanoseconds(time_s), time_s
