"""The ranges of the signals that a learned law may follow."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from gyrocal_ros.data import CovariateSample, ImuSample, Source, TemperatureSample, WheelSample
from gyrocal_ros.effects.learned.signals import CENTRIPETAL, GROWING_LAG, RATE
from gyrocal_ros.model.recording import SPEED_SIGNAL, TEMPERATURE

RANGE = (0.002, 0.998)
"""Quantiles of a signal between which its curve is learned."""
SMOOTHING_S = 0.07
"""Time over which the specific force is averaged: about that between two images."""

MIN_BLOCKS = 10
"""Number of such times below which nothing can be learned."""


def signal_ranges(source: Source) -> dict[str, tuple[float, float]]:
    """Return the range of each signal of a recording that varies, by its name in learned effects."""
    columns: dict[str, list[float]] = defaultdict(list)
    imu: list[tuple[float, ...]] = []
    times_ns: list[int] = []
    wheels: list[tuple[float, float]] = []
    for sample in source.measurements():
        if isinstance(sample, ImuSample):
            times_ns.append(sample.t_ns)
            imu.append((sample.rate_rad_s[2], *sample.specific_force_m_s2))
        elif isinstance(sample, WheelSample):
            wheels.append((sample.t_ns, sample.speed_m_s))
        elif isinstance(sample, CovariateSample):
            columns[sample.name].append(sample.value)
        elif isinstance(sample, TemperatureSample):
            columns[TEMPERATURE].append(sample.temperature_c)
    if not times_ns:
        return {}
    readings, time_s = np.array(imu), 1e-9 * (np.array(times_ns) - times_ns[0])
    steps_s = np.diff(time_s)
    steps_s = steps_s[steps_s < SMOOTHING_S]  # a longer one is a gap
    count = round(SMOOTHING_S / float(steps_s.mean())) if len(steps_s) else 1
    blocks = len(readings) // count
    if blocks < MIN_BLOCKS:
        return {}
    means = readings[: blocks * count].reshape(blocks, count, 4).mean(axis=1)
    smooth = dict(zip((RATE, 'force_x', 'force_y', 'force_z'), means.T, strict=True))
    middle_s = time_s[: blocks * count].reshape(blocks, count).mean(axis=1)
    smooth['yaw_acceleration'] = np.gradient(smooth[RATE], middle_s)
    smooth[GROWING_LAG] = np.abs(smooth[RATE]) * smooth['yaw_acceleration']
    if wheels:
        wheel_ns, speed_m_s = np.array(wheels).T
        smooth[SPEED_SIGNAL] = np.interp(middle_s, 1e-9 * (wheel_ns - times_ns[0]), speed_m_s)
        smooth[CENTRIPETAL] = smooth[RATE] * smooth[SPEED_SIGNAL]
    every = {name: np.array(values) for name, values in columns.items()} | smooth
    ranges = {name: np.quantile(values, RANGE).tolist() for name, values in every.items()}
    return {name: (low, high) for name, (low, high) in ranges.items() if high - low > 1e-6 * abs(high + low)}
