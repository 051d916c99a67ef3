"""Noise of gyro and wheels: what one block adds to the covariance of the pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array, quickly_filled
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import NoiseEffect, SensorModel, placed


@dataclass(frozen=True, slots=True, eq=False)
class YawNoise:
    """Noise of the yaw rate."""

    density_rad_s: Array
    """(N,) density of the white noise, rad/s/sqrt(Hz)."""
    bias_walk_rad_s: float
    """Random walk of the bias, rad/s/sqrt(s)."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class BlockNoise:
    """Noise of gyro and wheels in one block of N intervals."""

    tilt_density_rad_s: Array
    """(2,) densities of the white noise of the x and y gyros, rad/s/sqrt(Hz)."""
    yaw_density_rad_s: Array | float
    """(N,) the same of the yaw gyro, or one for all intervals."""
    gap_rad: float
    """Standard deviation of each angle by times without samples."""
    unknown_rad: float
    """Standard deviation of the turn that the gyro could not measure."""
    wheels: tuple[float, float, float, float]
    """Noise along, across and up, in m per sqrt(m) of way, and of each, in m per sqrt(rad)."""
    wheel_gap_m: float
    """Standard deviation of the motion on the floor by times without wheel encoders."""
    tilt_walk_rad_s: float
    yaw_walk_rad_s: float
    """Random walks of the biases of the x and y gyros and of the yaw gyro, rad/s/sqrt(s)."""
    walks: Array
    """(k,) random walks of the coefficients, per sqrt(s)."""
    duration_s: float
    """Length of the block."""


def yaw_noise(
    effects: Sequence[tuple[NoiseEffect, slice]], values: Array, gyro: GyroConfig, rate_rad_s: Array
) -> YawNoise:
    """Add up the independent noises of settings and effects.

    Args:
        effects: effects on the noise, with the place of their coefficients among all.
        values: (K,) coefficients.
        gyro: settings.
        rate_rad_s: (N,) readings of the yaw rate.
    """
    density, walk = math.radians(gyro.rate_noise_deg_s), math.radians(gyro.bias_walk_deg_s)
    if not effects:
        return YawNoise(np.full(len(rate_rad_s), density), walk)
    variance, walk = np.full(len(rate_rad_s), density**2), walk**2
    for effect, place in effects:
        variance += effect.density(rate_rad_s, values[place]) ** 2
        walk += effect.bias_walk(values[place]) ** 2
    return YawNoise(np.sqrt(variance), math.sqrt(walk))


def yaw_noise_of(model: SensorModel, gyro: GyroConfig, rate_rad_s: Array) -> YawNoise:
    """Return the noise with a model, at readings (N,) of the yaw rate; see `yaw_noise`."""
    values = np.array([item.prior_mean for item in model.coefficients])
    return yaw_noise(placed(model.effects, 'noise'), values, gyro, rate_rad_s)


def process_noise(
    noise: BlockNoise,
    rate_gain: Array,
    mid_euler_rad: Array,
    dt_s: Array,
    yaw_rate_rad_s: Array,
    distance_m: Array,
) -> Array:
    """Return the covariance (r, r) that one block of N intervals adds to the robot part of the state.

    Args:
        noise: of the block.
        rate_gain: (6, 3, N) d pose / d body rate of each interval.
        mid_euler_rad: (3, N) attitude in the middle of each interval.
        dt_s: (N,)
        yaw_rate_rad_s: (N,) readings.
        distance_m: (N,) by the wheels.
    """
    density = np.empty((3, len(dt_s)))
    density[:2] = noise.tilt_density_rad_s[:, None]
    density[2] = noise.yaw_density_rad_s
    by_rate = (rate_gain * (density / np.sqrt(dt_s))).reshape(6, -1)
    along, across, up, turning = np.square(noise.wheels)
    way_m = np.abs(distance_m).sum()
    floor = turning * (np.abs(yaw_rate_rad_s) @ dt_s) + noise.wheel_gap_m**2
    R_wb = rotation_from_euler(mid_euler_rad[:, len(dt_s) // 2])
    of_biases = [noise.tilt_walk_rad_s, noise.tilt_walk_rad_s, noise.yaw_walk_rad_s]
    walks = math.sqrt(noise.duration_s) * np.concatenate([of_biases, noise.walks])
    added = np.diag(np.concatenate([np.zeros(3), np.full(3, noise.gap_rad), walks]) ** 2)
    added[:6, :6] += by_rate @ by_rate.T
    added[:3, :3] += R_wb * [way_m * along + floor, way_m * across + floor, way_m * up] @ R_wb.T
    added[5, 5] += noise.unknown_rad**2
    return added
