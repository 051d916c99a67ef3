"""Noise of gyro and wheels: what one block adds to the covariance of the pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import NoiseEffect, SensorModel, placed


@dataclass(frozen=True, slots=True, eq=False)
class YawNoise:
    """Noise of the yaw rate."""

    density_rad_s: Array
    """(N,) density of the white noise, rad/s/sqrt(Hz)."""
    bias_walk_rad_s: float
    """Random walk of the bias, rad/s/sqrt(s)."""


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


@compiled
def process_noise(
    rate_gain: Array,
    tilt_density_rad_s: Array,
    yaw_density_rad_s: Array,
    dt_s: Array,
    yaw_rate_rad_s: Array,
    distance_m: Array,
    mid_euler_rad: Array,
    gap_rad: float,
    unknown_rad: float,
    wheel_noise: tuple[float, float, float, float],
    wheel_gap_m: float,
    walks: Array,
) -> Array:
    """Return the covariance (r, r) that one block of N intervals adds to the robot part of the state.

    Args:
        rate_gain: (6, 3, N) d pose / d body rate of each interval.
        tilt_density_rad_s: (2,) densities of the white noise of the x and y gyros, rad/s/sqrt(Hz).
        yaw_density_rad_s: (N,) the same of the yaw gyro.
        dt_s: (N,)
        yaw_rate_rad_s: (N,) readings.
        distance_m: (N,) by the wheels.
        mid_euler_rad: (3, N) attitude in the middle of each interval.
        gap_rad: standard deviation of each angle by times without samples.
        unknown_rad: standard deviation of the turn that the gyro could not measure.
        wheel_noise: noise along, across and up, in m per sqrt(m) of way, and of each, in m per sqrt(rad).
        wheel_gap_m: standard deviation of the motion on the floor by times without wheel encoders.
        walks: (r - 6,) standard deviations of the changes of biases and coefficients in the block.
    """
    density = np.concatenate([np.tile(tilt_density_rad_s[:, None], len(dt_s)), yaw_density_rad_s[None]])
    by_rate = (rate_gain * (density / np.sqrt(dt_s))).reshape(6, -1)
    along, across, up, turning = np.square(wheel_noise)
    way_m, floor = np.abs(distance_m).sum(), turning * (np.abs(yaw_rate_rad_s) @ dt_s) + wheel_gap_m**2
    R_wb = rotation_from_euler(mid_euler_rad[:, len(dt_s) // 2])
    noise = np.diag(np.concatenate([np.zeros(3), np.full(3, gap_rad), walks]) ** 2)
    noise[:6, :6] += by_rate @ by_rate.T
    noise[:3, :3] += R_wb * [way_m * along + floor, way_m * across + floor, way_m * up] @ R_wb.T
    noise[5, 5] += unknown_rad**2
    return noise
