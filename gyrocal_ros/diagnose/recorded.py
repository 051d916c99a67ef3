"""What a recording offers as explanations, and its raw readings of the yaw rate."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import (
    Array,
    CovariateSample,
    ImuSample,
    IntArray,
    Rig,
    Source,
    TemperatureSample,
    WheelSample,
)
from gyrocal_ros.ekf.motion import SPEED_SIGNAL

MAX_SIGNALS = 24
"""No more recorded signals are put on trial than these, those that vary most by their own mean."""
SLOW_RAD_S = math.radians(2.0)
FEW, FEW_STEPS = 200, 10
"""Of fewer slow readings, or fewer different ones, nothing is told."""
ROUNDING, UNEVEN, MOSTLY = 1e-6, 0.02, 0.99
"""Readings of a converter lie whole steps from each other, but for what arithmetic rounds away."""
REPEATED = 0.5
"""Share of slow readings that repeat the one before where the noise is less than a third of a step."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A recorded signal that something may follow."""

    name: str
    mean: float
    spread: float
    """Standard deviation; a signal that does not vary is no signal."""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What a recording offers."""

    rig: Rig
    signals: tuple[Signal, ...]
    left_out: tuple[str, ...]
    """Signals beyond `MAX_SIGNALS`."""
    has_temperature: bool
    duration_s: float
    rate_t_ns: IntArray
    rate_rad_s: Array
    """(n,) the readings of the yaw rate."""

    @property
    def extras(self) -> set[str]:
        """What effects may need beside IMU, wheels and camera."""
        return {'temperature'} if self.has_temperature else set()


def coarse_step(recorded: Recorded) -> float | None:
    """Step (rad/s) from one reading to the next possible one, where it is wider than the gyro's noise.

    With noise the mean of many readings tells far less than a step; without, a rate that lies between
    two of them is read as the same wrong number throughout.
    """
    slow = np.abs(recorded.rate_rad_s) < SLOW_RAD_S
    steps = np.abs(np.diff(recorded.rate_rad_s))[slow[1:] & slow[:-1]]
    gaps = np.diff(np.unique(recorded.rate_rad_s))
    gaps = gaps[gaps > ROUNDING * gaps.max(initial=0.0)]
    if len(steps) < FEW or len(gaps) < FEW_STEPS:
        return None
    step = float(gaps.min())
    is_regular = np.abs(gaps / step - np.round(gaps / step)) < UNEVEN
    repeats = float(np.mean(steps < 0.5 * step))
    return step if is_regular.mean() > MOSTLY and repeats > REPEATED else None


def look_at(source: Source) -> Recorded:
    """See which signals a recording offers."""
    values: dict[str, list[float]] = defaultdict(list)
    rates: list[tuple[int, float]] = []
    has_temperature = False
    for sample in source.measurements():
        if isinstance(sample, ImuSample):
            rates.append((sample.t_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, CovariateSample):
            values[sample.name].append(sample.value)
        elif isinstance(sample, WheelSample):
            values[SPEED_SIGNAL].append(sample.speed_m_s)
        elif isinstance(sample, TemperatureSample):
            has_temperature = True
    signals = [Signal(name, float(np.mean(column)), float(np.std(column))) for name, column in values.items()]
    varying = [signal for signal in signals if signal.spread > 1e-6 * abs(signal.mean)]
    if len(varying) > MAX_SIGNALS:
        varying.sort(key=lambda signal: abs(signal.mean) / signal.spread)
    t_ns, rate = zip(*rates, strict=True) if rates else ((), ())
    return Recorded(
        rig=source.rig,
        signals=tuple(varying[:MAX_SIGNALS]),
        left_out=tuple(signal.name for signal in varying[MAX_SIGNALS:]),
        has_temperature=has_temperature,
        duration_s=source.span.duration_s,
        rate_t_ns=np.array(t_ns, np.int64),
        rate_rad_s=np.array(rate),
    )
