"""What the calibration is for: dead reckoning once the camera is off, beside the nominal gyro."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.calibrate import calibrate
from gyrocal_ros.config import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.drift import Path, dead_reckoning, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.state import YAW_BIAS
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

TEN_ROTATIONS_RAD = 20.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Errors gathered between two moments without the camera, one row an interval."""

    heading_rad: Array
    position_m: Array


def ten_rotations(seed: int) -> tuple[Drift, Drift]:
    """Errors after ten rotations to one side and after ten to the other: calibrated, nominal."""
    source = SimSource(find_scenario('blind_spins'), seed)
    run = calibrate(source, Config(), default_model())
    off_s = source.scenario.camera_until_s
    time_s = np.arange(off_s, source.scenario.duration_s, 0.02)
    turned = np.abs(np.gradient(source.truth.trajectory.motion(time_s).euler_rad[:, 2]))
    ends = np.interp([TEN_ROTATIONS_RAD, 2.0 * TEN_ROTATIONS_RAD], np.cumsum(turned), time_s)
    return _both(source, run, np.array([off_s, *ends]))


def ten_minutes(seed: int) -> tuple[Drift, Drift]:
    """Errors after ten minutes of cleaning: calibrated, nominal."""
    source = SimSource(find_scenario('blind_cleaning'), seed)
    run = calibrate(source, Config(), default_model())
    off_s = source.scenario.camera_until_s
    return _both(source, run, np.array([off_s, off_s + 600.0 - 0.1]))


def camera_off(seeds: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    for label, experiment in (('10 rotations', ten_rotations), ('10 minutes of cleaning', ten_minutes)):
        pairs = list(in_parallel(experiment, range(seeds)))
        for gyro, drifts in zip(('calibrated', 'nominal'), zip(*pairs, strict=True), strict=True):
            heading = np.degrees(np.concatenate([drift.heading_rad for drift in drifts]))
            position = np.concatenate([drift.position_m for drift in drifts])
            yield {
                'case': label,
                'gyro': gyro,
                'seeds': seeds,
                'heading_mean_abs_deg': float(np.abs(heading).mean()),
                'heading_max_abs_deg': float(np.abs(heading).max()),
                'heading_mean_deg': float(heading.mean()),
                'heading_sd_deg': float(heading.std(ddof=1)),
                'position_mean_m': float(position.mean()),
                'position_max_m': float(position.max()),
            }


def _both(source: SimSource, run: Run, moments_s: Array) -> tuple[Drift, Drift]:
    """The filter's own dead reckoning, and that of a nominal gyro whose bias was taken at rest."""
    off_ns = START_NS + int(source.scenario.camera_until_s * NS_PER_S)
    bias = float(run.history.mean[np.searchsorted(run.history.t_ns, off_ns) - 1, YAW_BIAS])
    nominal = dead_reckoning(run, np.zeros(len(run.model.coefficients)), bias)
    return _drift(source, run, slam_path(run), moments_s), _drift(source, run, nominal, moments_s)


def _drift(source: SimSource, run: Run, path: Path, moments_s: Array) -> Drift:
    """Heading error gathered in each interval, and position error at its end.

    Path and truth are laid on each other, in position and heading, at the first moment.
    """
    shift_s = (run.history.t_ns[0] - START_NS) / NS_PER_S
    trajectory = source.truth.trajectory
    true_yaw = trajectory.motion(moments_s).euler_rad[:, 2]
    true_position = trajectory.position(moments_s)[:, :2]
    yaw = np.interp(moments_s, path.time_s + shift_s, path.yaw_rad)
    position = np.stack(
        [np.interp(moments_s, path.time_s + shift_s, column) for column in path.position_m.T], axis=1
    )
    turn = true_yaw[0] - yaw[0]
    c, s = np.cos(turn), np.sin(turn)
    laid = (position - position[0]) @ np.array([[c, s], [-s, c]]) + true_position[0]
    error = np.linalg.norm(laid - true_position, axis=1)
    return Drift(np.diff(yaw - true_yaw), error[1:])
