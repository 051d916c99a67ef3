"""Scenarios drawn at random: another robot, room, drive and set of sensors for every seed.

The shipped scenarios share most of their numbers, so that what is tuned to one of them looks right in all.
The ranges are those of data sheets of consumer gyros, and of cleaning robots on the market.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.sim.manoeuvres import DrivingStyle
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.scene import Furniture
from gyrocal_ros.sim.sensors import SensorErrors, stream

PLANS = ('cleaning', 'lanes', 'rest_and_go', 'spins')
DURATION_S = (90.0, 400.0)
IMU_HZ, WHEEL_HZ, CAMERA_HZ = (50, 100, 200, 400), (20, 50, 100), (5, 8, 10, 15, 30)
FEATURES = (8, 40)
AREA_M = (1.5, 5.0)
"""Range of the sides of the cleaned area; the walls are a metre further."""
SLOWEST_DEG_S, FASTEST_DEG_S = (15.0, 60.0), (60.0, 170.0)
"""Ranges of the slowest and the fastest turn of a robot."""
TILT_SCALE_STD = 0.02
"""Standard deviation of the scale errors of the x and y gyros."""


def varied_scenario(seed: int) -> Scenario:
    """Return the scenario of a seed; its scale factor and hidden effects are left to the caller."""
    rng = stream(seed, 'varied scenario')
    duration_s = _log_uniform(rng, *DURATION_S)
    changes_s = np.sort(rng.uniform(0.2, 0.8, 2)) * duration_s
    area_m = tuple(rng.uniform(*AREA_M, 2))
    return replace(
        find_scenario('cleaning'),
        name='varied',
        about='a robot, a room and a drive drawn at random',
        stages=tuple(zip(rng.choice(PLANS, 3).tolist(), [*changes_s.tolist(), 0.0], strict=True)),
        duration_s=duration_s,
        standing_s=float(rng.choice([0.5, 3.0, 10.0])),
        imu_hz=int(rng.choice(IMU_HZ)),
        wheel_hz=int(rng.choice(WHEEL_HZ)),
        camera_hz=int(rng.choice(CAMERA_HZ)),
        features=round(_log_uniform(rng, *FEATURES)),
        track_loss=_log_uniform(rng, 5e-4, 2e-2),
        driving_style=DrivingStyle(
            speed_m_s=float(rng.uniform(0.15, 0.45)),
            turn_rates_deg_s=(float(rng.uniform(*SLOWEST_DEG_S)), float(rng.uniform(*FASTEST_DEG_S))),
            area_m=(float(area_m[0]), float(area_m[1])),
            lane_width_m=float(rng.uniform(0.15, 0.4)),
        ),
        errors=_with_tilt_errors(_errors(rng), seed),
        room_m=(float(area_m[0]) + 2.0, float(area_m[1]) + 2.0),
        corners=int(rng.integers(40, 160)),
        furniture=_tables(area_m, stream(seed, 'tables')),
        floor_tilt_deg=_log_uniform(rng, 0.05, 0.4),
        bumps=int(rng.integers(0, 10)),
        mount_xyz_m=(float(rng.uniform(-0.12, 0.12)), float(rng.uniform(-0.05, 0.05)), 0.1),
        mount_yaw_deg=float(rng.uniform(-180.0, 180.0)),
    )


def _tables(area_m: tuple[float, ...], rng: np.random.Generator) -> tuple[Furniture, ...]:
    """Draw the tables that the robot drives below: in two of three rooms none, else one or two."""
    tables = []
    for _ in range(rng.choice([0, 0, 0, 0, 1, 2])):
        x, y = (rng.uniform(-0.5, 0.5, 2) * area_m).tolist()
        half_x, half_y = rng.uniform(0.3, 0.8, 2).tolist()
        ends = (x - half_x, x + half_x), (y - half_y, y + half_y)
        tables.append(Furniture(*ends, float(rng.uniform(0.3, 0.8)), int(rng.integers(20, 60))))
    return tuple(tables)


def _errors(rng: np.random.Generator) -> SensorErrors:
    """Draw the errors of the sensors."""
    return SensorErrors(
        turn_on_bias_deg_s=_log_uniform(rng, 0.05, 1.0),
        bias_wander_deg_h=_log_uniform(rng, 2.0, 30.0),
        bias_wander_time_s=_log_uniform(rng, 100.0, 600.0),
        rate_noise_deg_s=_log_uniform(rng, 0.003, 0.015),  # more than twice the settings is a finding itself
        rate_step_deg_s=_log_uniform(rng, 0.002, 0.06),
        vibration_m_s2=_log_uniform(rng, 0.05, 0.5),
        wheel_noise_m=_log_uniform(rng, 0.002, 0.015),
        tick_m=_log_uniform(rng, 1e-4, 1e-3),
        track_error=float(rng.uniform(-0.03, 0.03)),
        pixel_noise_px=_log_uniform(rng, 0.1, 1.0),
        outliers=float(rng.choice([0.0, 0.0, 0.01, 0.03])),
    )


def _with_tilt_errors(errors: SensorErrors, seed: int) -> SensorErrors:
    """Draw the errors of the x and y gyros, which are of one design and err alike in part."""
    alike, of_x, of_y = TILT_SCALE_STD / math.sqrt(2.0) * stream(seed, 'tilt gyros').standard_normal(3)
    return replace(errors, x_scale_error=float(alike + of_x), y_scale_error=float(alike + of_y))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.uniform())
