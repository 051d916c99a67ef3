"""Forward simulation of physical effects: from true signals to sensor readings.

An effect defines how readings are to be corrected; a recording with a hidden effect contains the
readings that need exactly this correction. This module uses effects only through their protocols.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount, nanoseconds
from gyrocal_ros.effects.traits import required_signals
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import (
    CameraEffectOnOdometry,
    Effect,
    GyroEffectOnReadings,
    Place,
    RelativeEffect,
)
from gyrocal_ros.sim.trajectory import TrueMotion

MAX_ITERATIONS = 60
CONVERGED_RAD_S = 1e-13
DIVERGED_RAD_S = 1e3
ACCEPTED_RAD_S = 1e-7
"""Largest accepted change of the last iteration; an effect with steps may oscillate by a small amount."""


@dataclass(frozen=True, slots=True)
class HiddenEffect:
    """An effect that is simulated in a recording, with the true values of its coefficients."""

    effect: Effect
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        needed = len(self.effect.coefficients)
        if len(self.values) != needed:
            raise ConfigError(f'needs {needed} values, not {len(self.values)}', where=self.effect.name)
        if not isinstance(self.effect, GyroEffectOnReadings):
            return
        for item, value in zip(self.effect.coefficients, self.values, strict=True):
            if value < 0.0 and not (item.typical and item.typical.signed):
                raise ConfigError(f'cannot be {value:g}', where=self.effect.name, todo='give 0 or more')


Hidden = tuple[HiddenEffect, ...]


def referred_to_means(hidden: Hidden, means: Mapping[str, float]) -> Hidden:
    """Let effects of recorded signals count from the means of their signals, as these are reported.

    Raises:
        ConfigError: a signal is not recorded.
    """
    result = []
    for item in hidden:
        for signal in required_signals(item.effect):
            if signal != TEMPERATURE and signal not in means:
                todo = did_you_mean(signal, means)
                raise ConfigError(f'{signal!r} is not recorded', where=item.effect.name, todo=todo)
        if isinstance(item.effect, RelativeEffect):
            item = replace(item, effect=item.effect.counted_from(means[item.effect.signal]))
        result.append(item)
    return tuple(result)


def nominal_yaw_rate(true_rad_s: Array, scale_factor: float, block: MotionBlock, hidden: Hidden) -> Array:
    """Solve `true = scale factor * nominal + contributions(nominal)` for the nominal rate (n,).

    Args:
        true_rad_s: (n,) true yaw rate minus the bias.
        scale_factor: true rate over nominal rate.
        block: the whole recording, one interval per reading; its yaw rate is not used.
        hidden: effects; those that do not act on the gyro are ignored.

    Raises:
        ConfigError: there is no solution because an effect is too strong.
    """
    gyro = _acting_on(hidden, 'gyro')
    reading_effects = [
        (effect, values) for effect, values in gyro if isinstance(effect, GyroEffectOnReadings)
    ]
    rate_effects = [
        (effect, values) for effect, values in gyro if not isinstance(effect, GyroEffectOnReadings)
    ]
    nominal, change = true_rad_s / scale_factor, np.inf
    for _ in range(MAX_ITERATIONS):
        added = _contributions(rate_effects, _with_yaw_rate(block, nominal)) if rate_effects else 0.0
        result = (true_rad_s - added) / scale_factor
        for effect, values in reading_effects:
            result = effect.readings(result, block.dt_s, values, scale_factor)
        change, nominal = float(np.abs(result - nominal).max()), result
        if not CONVERGED_RAD_S < change < DIVERGED_RAD_S:
            break
    if not change < ACCEPTED_RAD_S:
        names = ', '.join(effect.name for effect, _ in gyro)
        raise ConfigError(
            'is too strong: no reading is consistent with the motion',
            where=names,
            todo='give a smaller value',
        )
    return nominal


def hidden_noise(block: MotionBlock, hidden: Hidden, rng: np.random.Generator) -> Array:
    """Draw the noise (n,) of the yaw rate by effects on the noise; zero without any."""
    noise = np.zeros(len(block.dt_s))
    for effect, values in _acting_on(hidden, 'noise'):
        white = effect.density(block.rate_rad_s[:, 2], values) / np.sqrt(block.dt_s)
        walk = effect.bias_walk(values) * np.sqrt(block.dt_s)
        noise += white * rng.standard_normal(len(noise)) + np.cumsum(walk * rng.standard_normal(len(noise)))
    return noise


def odometry_shortfall(block: MotionBlock, hidden: Hidden) -> Array:
    """Solve `true = odometry + contributions(odometry)` for the accumulated true minus odometry, (n + 1,).

    If the odometer has a scale error, `true` and the contributions are in metres of the odometer, as
    they are in the filter.

    Args:
        block: n true steps; the result is for the times before the first and after each of them.
        hidden: effects; those that do not change the odometry are ignored.
    """
    wheels = _acting_on(hidden, 'wheels')
    odometer_m = block.distance_m
    for effect, values in _acting_on(hidden, 'camera'):
        if isinstance(effect, CameraEffectOnOdometry):
            odometer_m = effect.odometry(odometer_m, values)
    shortfall = np.zeros(len(block.dt_s))
    for _ in range(MAX_ITERATIONS if wheels else 0):
        measured = replace(block, distance_m=odometer_m - shortfall)
        shortfall = np.sum([effect.contribute(measured, values)[0] for effect, values in wheels], axis=0)
    return np.concatenate([[0.0], np.cumsum(block.distance_m - odometer_m + shortfall)])


def ground_displacement(block: MotionBlock, hidden: Hidden) -> Array:
    """Return the displacement of the robot by the ground (n + 1, 3).

    It is the sum before the first and after each interval.
    """
    ground = _acting_on(hidden, 'ground')
    steps = np.zeros((len(block.dt_s) + 1, 3))
    for row, part in enumerate(_slices(block, 1) if ground else (), 1):
        steps[row] = sum(effect.contribute(part, values)[0] for effect, values in ground)
    return np.cumsum(steps, axis=0)


def true_camera(camera: CameraIntrinsics, mount: Mount, hidden: Hidden) -> tuple[CameraIntrinsics, Mount]:
    """Return the true camera and its mounting, given the nominal ones."""
    for effect, values in _acting_on(hidden, 'camera'):
        if not isinstance(effect, CameraEffectOnOdometry):
            camera, mount = effect.corrected(camera, mount, values)
    return camera, mount


def stamp_error_s(hidden: Hidden) -> float:
    """Return the stamp of an image minus its true time of exposure."""
    return sum(float(values[0]) for _, values in _acting_on(hidden, 'time'))


def readout_s(hidden: Hidden) -> float:
    """Return the time from the exposure of the first row of an image to that of the last one."""
    return sum(effect.readout_s(values)[0] for effect, values in _acting_on(hidden, 'shutter'))


def at_readings(motion: TrueMotion) -> MotionBlock:
    """Return the true motion at n times as a block with one interval around each of them."""
    dt_s = np.gradient(motion.time_s)
    return _block(motion, motion.time_s, dt_s, motion.rate_rad_s, motion.speed_m_s * dt_s)


def between(motion: TrueMotion) -> MotionBlock:
    """Return the true motion between n times as a block of n - 1 intervals."""
    middle_s = 0.5 * (motion.time_s[1:] + motion.time_s[:-1])
    rate = 0.5 * (motion.rate_rad_s[1:] + motion.rate_rad_s[:-1])
    return _block(motion, middle_s, np.diff(motion.time_s), rate, np.diff(motion.travelled_m))


def _block(
    motion: TrueMotion, time_s: Array, dt_s: Array, rate_rad_s: Array, distance_m: Array
) -> MotionBlock:
    return MotionBlock(
        start_ns=nanoseconds(float(motion.time_s[0])),
        end_ns=nanoseconds(float(motion.time_s[-1])),
        time_s=time_s,
        dt_s=dt_s,
        rate_rad_s=rate_rad_s,
        yaw_acceleration_rad_s2=np.gradient(rate_rad_s[:, 2]) / dt_s,
        specific_force_m_s2=np.zeros((len(dt_s), 3)),
        vibration_m2_s4=np.zeros(len(dt_s)),
        distance_m=distance_m,
        wheel_turn_rad=rate_rad_s[:, 2] * dt_s,
        temperature_c=np.full(len(dt_s), np.nan),
    )


def _acting_on(hidden: Hidden, place: Place) -> list[tuple[Any, Array]]:
    return [(item.effect, np.array(item.values)) for item in hidden if item.effect.acts_on == place]


def _contributions(effects: list[tuple[Any, Array]], block: MotionBlock) -> Array:
    """Return the sum (n,) of the contributions of gyro effects.

    They are computed in blocks of a second, as in the filter.
    """
    second = max(round(1.0 / float(block.dt_s[0])), 1)
    memories = [None] * len(effects)
    pieces = []
    for part in _slices(block, second):
        terms = [
            effect.contribute(part, values, memory)
            for (effect, values), memory in zip(effects, memories, strict=True)
        ]
        memories = [term.memory for term in terms]
        pieces.append(np.sum([term.rate_rad_s for term in terms], axis=0))
    return np.concatenate(pieces)


def _with_yaw_rate(block: MotionBlock, yaw_rate_rad_s: Array) -> MotionBlock:
    rates = np.column_stack([block.rate_rad_s[:, :2], yaw_rate_rad_s])
    acceleration = np.gradient(yaw_rate_rad_s) / block.dt_s
    return replace(block, rate_rad_s=rates, yaw_acceleration_rad_s2=acceleration)


def _slices(block: MotionBlock, count: int) -> Iterator[MotionBlock]:
    """Split a block into blocks of `count` intervals."""
    for first in range(0, len(block.dt_s), count):
        yield block.part(slice(first, first + count))
