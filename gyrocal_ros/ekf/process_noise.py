"""Noise of gyro and wheels: what one block adds to the covariance of the pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled
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
    variance = np.full(len(rate_rad_s), math.radians(gyro.rate_noise_deg_s) ** 2)
    walk = math.radians(gyro.bias_walk_deg_s) ** 2
    for effect, place in effects:
        variance += effect.density(rate_rad_s, values[place]) ** 2
        walk += effect.bias_walk(values[place]) ** 2
    return YawNoise(np.sqrt(variance), math.sqrt(walk))


def yaw_noise_of(model: SensorModel, gyro: GyroConfig, rate_rad_s: Array) -> YawNoise:
    """Return the noise with a model, at readings (N,) of the yaw rate; see `yaw_noise`."""
    values = np.array([item.prior_mean for item in model.coefficients])
    return yaw_noise(placed(model.effects, 'noise'), values, gyro, rate_rad_s)


@compiled
def pose_noise(
    rate_gain: Array, density_rad_s: Array, dt_s: Array, R_wb: Array, gap_rad: float, step_variance_m2: Array
) -> Array:
    """Return the covariance (6, 6) that one block of N intervals adds to position and Euler angles.

    Args:
        rate_gain: (6, 3, N) d pose / d body rate of each interval.
        density_rad_s: (3, N) densities of the white noise of the gyro axes, rad/s/sqrt(Hz).
        dt_s: (N,)
        R_wb: (3, 3) attitude.
        gap_rad: standard deviation of each angle by times without samples.
        step_variance_m2: (3,) variances of the motion along the body axes.
    """
    by_rate = (rate_gain * (density_rad_s / np.sqrt(dt_s))).reshape(6, -1)
    noise: Array = by_rate @ by_rate.T
    noise[3:, 3:] += gap_rad**2 * np.eye(3)
    noise[:3, :3] += R_wb * step_variance_m2 @ R_wb.T
    return noise
