"""Dead reckoning with the camera off, by the calibrated and by the nominal gyro."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.drift import dead_reckoning
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

TEN_ROTATIONS_RAD = 20.0 * np.pi
TEN_MINUTES_S = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Errors that accumulate without the camera, one row per interval."""

    heading_rad: Array
    position_m: Array
    turned_rad: Array
    """True turn of the robot, to the left positive."""


def ten_rotations(seed: int) -> tuple[Drift, Drift]:
    """Return the errors after ten rotations to one side and after ten to the other: calibrated, nominal."""
    return rotations(find_scenario('blind_spins'), seed)


def ten_minutes(seed: int) -> tuple[Drift, Drift]:
    """Return the errors after ten minutes of cleaning: calibrated, nominal."""
    return minutes(find_scenario('blind_cleaning'), seed)


def rotations(scenario: Scenario, seed: int) -> tuple[Drift, Drift]:
    """Run `ten_rotations` with a scenario like `blind_spins`."""
    source = SimSource(scenario, seed)
    run = calibrate(source, Config(), default_model())
    return calibrated_and_nominal(source, run, rotation_ends_s(source))


def minutes(scenario: Scenario, seed: int, config: Config | None = None) -> tuple[Drift, Drift]:
    """Run `ten_minutes` with a scenario like `blind_cleaning`, with other settings."""
    source = SimSource(scenario, seed)
    run = calibrate(source, config or Config(), default_model())
    off_s = source.scenario.camera_until_s
    return calibrated_and_nominal(source, run, np.array([off_s, off_s + TEN_MINUTES_S - 0.1]))


def rotation_ends_s(source: SimSource) -> Array:
    """Return the times (3,) at which the camera goes off, and after ten and after twenty rotations."""
    off_s = source.scenario.camera_until_s
    time_s = np.arange(off_s, source.scenario.duration_s, 0.02)
    turned = np.abs(np.gradient(source.truth.trajectory.motion(time_s).euler_rad[:, 2]))
    ends = np.interp([TEN_ROTATIONS_RAD, 2.0 * TEN_ROTATIONS_RAD], np.cumsum(turned), time_s)
    return np.array([off_s, *ends])


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


def calibrated_and_nominal(source: SimSource, run: Run, moments_s: Array) -> tuple[Drift, Drift]:
    """Return the drift of the filter, and of a nominal gyro with the bias estimated before."""
    return (
        accumulated_drift(source, run, slam_path(run), moments_s),
        accumulated_drift(source, run, nominal_path(source, run), moments_s),
    )


def nominal_path(source: SimSource, run: Run) -> Trajectory2D:
    """Return the dead reckoning by the data sheet's scale factor, with the bias at the end of the camera."""
    return dead_reckoning(run, np.zeros(len(run.model.coefficients)), bias_at_off(source, run))


def bias_at_off(source: SimSource, run: Run) -> float:
    """Return the estimated yaw bias, rad/s, at the time when the camera goes off."""
    off_ns = START_NS + int(source.scenario.camera_until_s * NS_PER_S)
    return float(run.history.mean[np.searchsorted(run.history.t_ns, off_ns) - 1, YAW_BIAS])


def accumulated_drift(source: SimSource, run: Run, path: Trajectory2D, moments_s: Array) -> Drift:
    """Return the heading error of each interval, and the position error at its end.

    Path and truth are aligned, in position and heading, at the first moment.
    """
    true_yaw = source.truth.trajectory.motion(moments_s).euler_rad[:, 2]
    aligned, yaw = aligned_to_truth(source, run, path, moments_s)
    error = np.linalg.norm(aligned - source.truth.position(moments_s)[:, :2], axis=1)
    return Drift(np.diff(yaw - true_yaw), error[1:], np.diff(true_yaw))


def aligned_to_truth(
    source: SimSource, run: Run, path: Trajectory2D, moments_s: Array
) -> tuple[Array, Array]:
    """Return a path at moments (n,), moved and turned so that it begins at the true pose.

    Returns:
        Positions (n, 2) in the world, and headings (n,).
    """
    shift_s = (run.history.t_ns[0] - START_NS) / NS_PER_S
    start = source.truth.position(moments_s[:1])[0, :2]
    start_yaw = float(source.truth.trajectory.motion(moments_s[:1]).euler_rad[0, 2])
    yaw = np.interp(moments_s, path.time_s + shift_s, path.yaw_rad)
    position = np.stack(
        [np.interp(moments_s, path.time_s + shift_s, column) for column in path.position_m.T], axis=1
    )
    turn = start_yaw - yaw[0]
    c, s = np.cos(turn), np.sin(turn)
    return (position - position[0]) @ np.array([[c, s], [-s, c]]) + start, yaw + turn
