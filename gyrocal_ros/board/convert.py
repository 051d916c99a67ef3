"""Conversion of counts to samples in SI units, with the constants of `BoardConfig`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.board.clock import Stamp
from gyrocal_ros.board.messages import Imu, Supply, Wheels
from gyrocal_ros.board.protocol import TIME_WRAP
from gyrocal_ros.config.robot_sections import BoardConfig, Triple
from gyrocal_ros.data import ImuSample, TemperatureSample, WheelSample

TICK_WRAP = 1 << 32
MAX_INTERVAL_S = 1.0
"""Longest interval over which a mean speed is computed. A longer mean does not describe the motion."""
US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class SupplySample:
    """Battery voltage and motor current."""

    t_ns: int
    voltage_v: float
    current_a: float
    """Current of the drive motors, negative when discharging."""


@dataclass(frozen=True, slots=True)
class WheelReading:
    """The tick counters at one time."""

    stamp: Stamp
    time_us: int
    """Board time as received."""
    wheels: Wheels


def imu_sample(imu: Imu, t_ns: int, config: BoardConfig) -> ImuSample:
    """Convert gyro and accelerometer counts; the nominal scale factor and bias are applied."""
    volts = _to_physical(imu.gyro, config.gyro_zero, (config.gyro_volt,) * 3)
    x, y, z = (
        math.radians(volt * scale) for volt, scale in zip(volts, config.gyro_scale_factor_volt, strict=True)
    )
    force = _to_physical(imu.accelerometer, config.accelerometer_zero, config.accelerometer_scale)
    return ImuSample(t_ns, (x, y, z), force)


def temperature_sample(imu: Imu, t_ns: int, config: BoardConfig) -> TemperatureSample:
    """Convert the temperature in an IMU message."""
    return TemperatureSample(t_ns, config.temperature_zero_c + imu.temperature * config.temperature_scale)


def supply_sample(supply: Supply, t_ns: int) -> SupplySample:
    """Convert voltage and current."""
    return SupplySample(t_ns, supply.voltage / 1000.0, supply.motor_current / 1000.0)


def wheel_step(before: WheelReading, after: WheelReading, config: BoardConfig) -> tuple[float, float]:
    """Return the distance (m) and the turn (rad) from one reading to the next.

    Both are 0 if the board was restarted in between, because the motion is then unknown.
    """
    if before.stamp.base != after.stamp.base:
        return 0.0, 0.0
    left_m = _tick_difference(before.wheels.left, after.wheels.left) * config.tick_m
    right_m = _tick_difference(before.wheels.right, after.wheels.right) * config.tick_m
    return (left_m + right_m) / 2.0, (right_m - left_m) / config.track_m


def wheel_sample(before: WheelReading, after: WheelReading, config: BoardConfig) -> WheelSample | None:
    """Return the mean motion from one reading to the next, or None if it is unknown.

    It is unknown if the board was restarted in between, if no time has passed, or if more than
    `MAX_INTERVAL_S` has passed. The interval is measured by the board's clock, which is independent of
    the arrivals.
    """
    duration_s = (after.time_us - before.time_us) % TIME_WRAP / US_PER_S
    if before.stamp.base != after.stamp.base or not 0.0 < duration_s <= MAX_INTERVAL_S:
        return None
    distance_m, turned_rad = wheel_step(before, after, config)
    return WheelSample(after.stamp.t_ns, distance_m / duration_s, turned_rad / duration_s)


def _to_physical(counts: tuple[int, int, int], zeros: Triple, scales: Triple) -> Triple:
    x, y, z = ((n - zero) * scale for n, zero, scale in zip(counts, zeros, scales, strict=True))
    return x, y, z


def _tick_difference(before: int, after: int) -> int:
    """Return the number of ticks from one count to the next, modulo the wrap of the counter."""
    return (after - before + TICK_WRAP // 2) % TICK_WRAP - TICK_WRAP // 2
