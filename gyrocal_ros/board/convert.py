"""Counts become samples in SI units, by what the data sheets and the drawings of the robot say."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.board.clock import Stamp
from gyrocal_ros.board.messages import Imu, Supply, Wheels
from gyrocal_ros.board.protocol import TIME_WRAP
from gyrocal_ros.config.sections import BoardConfig, Three
from gyrocal_ros.data import ImuSample, TemperatureSample, WheelSample

TICK_WRAP = 1 << 32
LONGEST_INTERVAL_S = 1.0
"""A mean over a longer time says little of the motion in it."""
US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class SupplySample:
    """The battery's side of the robot."""

    t_ns: int
    voltage_v: float
    current_a: float
    """Of the drive motors, negative when discharging."""


@dataclass(frozen=True, slots=True)
class WheelReading:
    """The tick counters at one moment."""

    stamp: Stamp
    time_us: int
    """Board time, as it came."""
    wheels: Wheels


def imu_sample(imu: Imu, t_ns: int, config: BoardConfig) -> ImuSample:
    """Convert gyros and accelerometers, nominal scale factor and bias applied."""
    volts = _scaled(imu.gyro, config.gyro_zero, (config.gyro_volt,) * 3)
    x, y, z = (
        math.radians(volt * scale) for volt, scale in zip(volts, config.gyro_scale_factor_volt, strict=True)
    )
    force = _scaled(imu.accelerometer, config.accelerometer_zero, config.accelerometer_scale)
    return ImuSample(t_ns, (x, y, z), force)


def temperature_sample(imu: Imu, t_ns: int, config: BoardConfig) -> TemperatureSample:
    """Convert the temperature that comes with the gyros."""
    return TemperatureSample(t_ns, config.temperature_zero_c + imu.temperature * config.temperature_scale)


def supply_sample(supply: Supply, t_ns: int) -> SupplySample:
    """Convert voltage and current."""
    return SupplySample(t_ns, supply.voltage / 1000.0, supply.motor_current / 1000.0)


def wheel_step(before: WheelReading, after: WheelReading, config: BoardConfig) -> tuple[float, float]:
    """Return how far the robot went (m) and turned (rad) from one reading to the next.

    No motion is known where the board was started anew in between.
    """
    if before.stamp.base != after.stamp.base:
        return 0.0, 0.0
    left_m = _ticks(before.wheels.left, after.wheels.left) * config.tick_m
    right_m = _ticks(before.wheels.right, after.wheels.right) * config.tick_m
    return (left_m + right_m) / 2.0, (right_m - left_m) / config.track_m


def wheel_sample(before: WheelReading, after: WheelReading, config: BoardConfig) -> WheelSample | None:
    """Return the mean motion from one reading to the next; None where there is none to be had.

    That is so when the board was started anew in between, when no time has passed, or more than
    `LONGEST_INTERVAL_S`. The time is the board's own, which no arrival disturbs.
    """
    duration_s = (after.time_us - before.time_us) % TIME_WRAP / US_PER_S
    if before.stamp.base != after.stamp.base or not 0.0 < duration_s <= LONGEST_INTERVAL_S:
        return None
    distance_m, turned_rad = wheel_step(before, after, config)
    return WheelSample(after.stamp.t_ns, distance_m / duration_s, turned_rad / duration_s)


def _scaled(counts: tuple[int, int, int], zeros: Three, scales: Three) -> Three:
    x, y, z = ((n - zero) * scale for n, zero, scale in zip(counts, zeros, scales, strict=True))
    return x, y, z


def _ticks(before: int, after: int) -> int:
    """Ticks from one count to the next, over the wrap of the counter."""
    return (after - before + TICK_WRAP // 2) % TICK_WRAP - TICK_WRAP // 2
