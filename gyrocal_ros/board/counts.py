"""Conversion of samples in SI units to counts: the inverse of `convert`, for the emulated board."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrocal_ros.board.convert import TICK_WRAP
from gyrocal_ros.board.messages import Imu, IntTriple, Supply, Wheels
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import ImuSample

I16, I32, U16 = (-(1 << 15), (1 << 15) - 1), (-(1 << 31), (1 << 31) - 1), (0, (1 << 16) - 1)


def imu_counts(sample: ImuSample, temperature_c: float, config: BoardConfig) -> Imu:
    """Return the nearest counts, clipped to the range of each converter."""
    volts = [
        math.degrees(rate) / scale
        for rate, scale in zip(sample.rate_rad_s, config.gyro_scale_factor_volt, strict=True)
    ]
    return Imu(
        _counts(volts, config.gyro_zero, (config.gyro_volt,) * 3, I32),
        _counts(sample.specific_force_m_s2, config.accelerometer_zero, config.accelerometer_scale, I16),
        _clipped((temperature_c - config.temperature_zero_c) / config.temperature_scale, I16),
    )


def wheel_counts(distance_m: float, turned_rad: float, config: BoardConfig) -> Wheels:
    """Return the tick counters, zero at the start, after the given distance and turn."""
    half_difference_m = turned_rad * config.track_m / 2.0
    return Wheels(
        _tick_count(distance_m - half_difference_m, config),
        _tick_count(distance_m + half_difference_m, config),
    )


def supply_counts(voltage_v: float, current_a: float) -> Supply:
    """Return the nearest counts."""
    return Supply(_clipped(1000.0 * voltage_v, U16), _clipped(1000.0 * current_a, I32))


def _counts(
    values: Sequence[float], zeros: Sequence[float], scales: Sequence[float], limits: tuple[int, int]
) -> IntTriple:
    x, y, z = (
        _clipped(value / scale + zero, limits)
        for value, zero, scale in zip(values, zeros, scales, strict=True)
    )
    return x, y, z


def _clipped(value: float, limits: tuple[int, int]) -> int:
    low, high = limits
    return round(min(max(value, low), high))


def _tick_count(distance_m: float, config: BoardConfig) -> int:
    return (round(distance_m / config.tick_m) + TICK_WRAP // 2) % TICK_WRAP - TICK_WRAP // 2
