"""Calibration without a ceiling camera: bias at rest, scale factor by the wheels or by spins at a wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, ImuSample, Measurement, WheelSample
from gyrocal_ros.sim.manoeuvres import rest, turn
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.world import START_NS, SimSource

WALL_SPINS = ((0.5, 1), (1.5, 1), (3.0, 2), (-0.5, 1), (-1.5, 1), (-3.0, 2))
"""Rates (rad/s) and turns, as in the base calibration of the package robot_calibration."""
PAUSE_S = 1.0


@dataclass(frozen=True, slots=True)
class WheelFit:
    """Scale factor and bias by least squares over the recording up to each of several times."""

    time_s: Array
    """(n,) times since the start, at intervals of one second."""
    scale: Array
    bias_rad_s: Array


def bias_at_rest(measurements: Sequence[Measurement], standing_s: float) -> float:
    """Return the bias, rad/s, that makes the mean rate of the first seconds zero."""
    end_ns = START_NS + int(standing_s * NS_PER_S)
    read = [item.rate_rad_s[2] for item in measurements if isinstance(item, ImuSample) and item.t_ns < end_ns]
    return -float(np.mean(read))


def fit_to_wheels(measurements: Sequence[Measurement]) -> WheelFit:
    """Fit `wheel turn = scale * gyro turn + bias * time` by least squares over the encoder intervals."""
    imu = [item for item in measurements if isinstance(item, ImuSample)]
    wheels = [item for item in measurements if isinstance(item, WheelSample)]
    imu_s = np.array([item.t_ns - START_NS for item in imu]) / NS_PER_S
    wheel_s = np.array([item.t_ns - START_NS for item in wheels]) / NS_PER_S
    rate = np.array([item.rate_rad_s[2] for item in imu])
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu_s))])
    dt_s = np.diff(wheel_s)
    gyro = np.diff(np.interp(wheel_s, imu_s, turned))
    wheel = np.array([item.yaw_rate_rad_s for item in wheels])[1:] * dt_s
    sums = np.cumsum([gyro * gyro, gyro * dt_s, dt_s * dt_s, gyro * wheel, dt_s * wheel], axis=1)
    ends = np.searchsorted(wheel_s[1:], np.arange(1.0, math.floor(wheel_s[-1]) + 1.0)) - 1
    gg, gt, tt, gw, tw = sums[:, ends]
    determinant = np.maximum(gg * tt - gt * gt, 1e-300)
    scale, bias = (gw * tt - tw * gt) / determinant, (gg * tw - gt * gw) / determinant
    return WheelFit(wheel_s[1:][ends], scale, bias)


def spins_against_wall(scenario: Scenario, seed: int) -> tuple[float, float]:
    """Return the scale factor by spins whose turns are known exactly, and their duration, s.

    There are as many turns to the right as to the left, so a bias cancels.

    Args:
        scenario: scenario of the robot; its drive is replaced.
        seed: seed of the robot; its gyro is the same as in any recording of that seed.
    """
    spins = [turn(math.copysign(2.0 * math.pi * turns, rate), abs(rate)) for rate, turns in WALL_SPINS]
    legs = tuple(leg for spin in spins for leg in (*spin, *rest(PAUSE_S)))
    done_s = sum(leg.duration_s for leg in legs)
    drive = replace(
        scenario,
        legs=legs,
        duration_s=scenario.standing_s + done_s,
        camera_until_s=0.0,
        floor_tilt_deg=0.0,
        bumps=0,
    )
    imu = [item for item in SimSource(drive, seed).measurements() if isinstance(item, ImuSample)]
    time_s = np.array([item.t_ns - START_NS for item in imu]) / NS_PER_S
    rate = np.array([item.rate_rad_s[2] for item in imu])
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])
    ends_s = scenario.standing_s + np.cumsum(
        [sum(leg.duration_s for leg in spin) + PAUSE_S for spin in spins]
    )
    starts_s = np.concatenate([[scenario.standing_s], ends_s[:-1]])
    read = np.interp(ends_s - PAUSE_S, time_s, turned) - np.interp(starts_s, time_s, turned)
    signs = np.array([math.copysign(1.0, rate) for rate, _ in WALL_SPINS])
    exact = 2.0 * math.pi * sum(turns for _, turns in WALL_SPINS)
    return exact / float(signs @ read), done_s
