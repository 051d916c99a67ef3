"""Counts become samples in SI units, by what the data sheets and the drawings of the robot say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

from gyrocal_ros.board.clock import Stamp
from gyrocal_ros.board.messages import Imu, Supply, Wheels
from gyrocal_ros.board.protocol import TIME_WRAP
from gyrocal_ros.config import GyroConfig, setting
from gyrocal_ros.data import CovariateSample, ImuSample, TemperatureSample, WheelSample

Three: TypeAlias = tuple[float, float, float]

STANDARD_GRAVITY_M_S2 = 9.80665
TICK_WRAP = 1 << 32
LONGEST_INTERVAL_S = 1.0
"""A mean over a longer time says little of the motion in it."""
US_PER_S = 1_000_000


@dataclass(frozen=True, slots=True)
class BoardConfig:
    """What one count of each converter means."""

    gyro_volt: float = setting(
        1e-5, 'V/count', 'gyro voltage that one count stands for', low=1e-12, high=10.0
    )
    gyro_scale_factor_volt: Three = setting(
        (GyroConfig().nominal_scale_factor_volt,) * 3,
        'deg/s/V',
        'scale factor by the data sheet, about x, y and z; negative where an axis is mounted in reverse',
        low=-1e6,
        high=1e6,
    )
    gyro_zero: Three = setting(
        (0.0, 0.0, 0.0), 'count', 'nominal bias: counts of the gyros at rest', low=-(2.0**31), high=2.0**31
    )
    accelerometer_scale: Three = setting(
        (4.0 * STANDARD_GRAVITY_M_S2 / 2**15,) * 3,
        'm/s^2/count',
        'specific force that one count stands for, along x, y and z; 16 bits over 4 g to either side',
        low=-100.0,
        high=100.0,
    )
    accelerometer_zero: Three = setting(
        (0.0, 0.0, 0.0), 'count', 'counts of the accelerometers without force', low=-(2.0**15), high=2.0**15
    )
    temperature_scale: float = setting(
        0.01, 'deg C/count', 'one count of temperature', low=-100.0, high=100.0
    )
    temperature_zero_c: float = setting(0.0, 'deg C', 'temperature at 0 counts', low=-273.15, high=1000.0)
    tick_m: float = setting(3e-4, 'm', 'way of a wheel from one tick to the next', low=1e-7, high=1.0)
    track_m: float = setting(0.23, 'm', 'distance between the wheels', low=0.01, high=10.0)


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


def supply_samples(supply: Supply, t_ns: int) -> tuple[CovariateSample, CovariateSample]:
    """Name voltage (V) and current (A, negative when discharging) as a recorded BatteryState would."""
    return (
        CovariateSample(t_ns, 'battery_state.voltage', supply.voltage / 1000.0),
        CovariateSample(t_ns, 'battery_state.current', supply.motor_current / 1000.0),
    )


def wheel_sample(before: WheelReading, after: WheelReading, config: BoardConfig) -> WheelSample | None:
    """Return the mean motion from one reading to the next; None where there is none to be had.

    That is so when the board was started anew in between, when no time has passed, or more than
    `LONGEST_INTERVAL_S`. The time is the board's own, which no arrival disturbs.
    """
    duration_s = (after.time_us - before.time_us) % TIME_WRAP / US_PER_S
    if before.stamp.base != after.stamp.base or not 0.0 < duration_s <= LONGEST_INTERVAL_S:
        return None
    left_m = _ticks(before.wheels.left, after.wheels.left) * config.tick_m
    right_m = _ticks(before.wheels.right, after.wheels.right) * config.tick_m
    speed = (left_m + right_m) / 2.0 / duration_s
    return WheelSample(after.stamp.t_ns, speed, (right_m - left_m) / config.track_m / duration_s)


def _scaled(counts: tuple[int, int, int], zeros: Three, scales: Three) -> Three:
    x, y, z = ((n - zero) * scale for n, zero, scale in zip(counts, zeros, scales, strict=True))
    return x, y, z


def _ticks(before: int, after: int) -> int:
    """Ticks from one count to the next, over the wrap of the counter."""
    return (after - before + TICK_WRAP // 2) % TICK_WRAP - TICK_WRAP // 2
