"""Figs. 12 and 13: estimated trajectories by dead reckoning and by SLAM.

One robot drives lanes over a room. In Fig. 12 the camera is covered after two minutes; in Fig. 13 it is not,
and SLAM is compared with the same dead reckoning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.camera_off import aligned_to_truth, nominal_path
from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assess
from gyrocal_ros.bench.paper.without_camera import NOMINAL_ERROR
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

OFF_S, END_S, STEP_S = 120.0, 300.0, 0.2
SETTLED_S = 1.0
"""Time after the start at which the SLAM path is aligned to the truth."""


GYRO, NOMINAL, SLAM, TRUTH = 'calibrated gyro', 'nominal gyro', 'SLAM', 'ground truth'


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """One of the two figures."""

    tracks: dict[str, Trajectory2D]
    """Trajectories of the first seed by name, aligned to the truth at their beginnings."""
    end_errors_m: dict[str, Array]
    """(seeds,) distances from the truth at the end, by name."""
    claims: tuple[Claim, ...]


def figure_12(each: Mapper, seeds: int) -> Tracks:
    """Compare three minutes of lanes with the camera covered, calibrated and nominal."""
    results = list(each(_camera_covered, list(range(seeds))))
    ends = _end_errors(results)
    calibrated, nominal = ends[GYRO], ends[NOMINAL]
    claims = (
        assess(
            'end position by dead reckoning, calibrated',
            '13.8 cm',
            _centimetres(calibrated),
            float(calibrated.mean()) < 0.138,
        ),
        assess(
            'not calibrated',
            '66.0 cm',
            f'{_centimetres(nominal)}; scale factor wrong by {100.0 * NOMINAL_ERROR:.2f} % as in Table 1',
            float(nominal.mean()) > 3.0 * float(calibrated.mean()),
        ),
    )
    return Tracks(results[0], ends, claims)


def figure_13(each: Mapper, seeds: int) -> Tracks:
    """Compare SLAM with the camera on and the dead reckoning of Fig. 12."""
    results = list(each(_camera_on, list(range(seeds))))
    ends = _end_errors(results)
    claims = (
        assess(
            'SLAM stays on the ground truth',
            'by eye',
            f'error at the end of 5 minutes: {_centimetres(ends[SLAM])}',
            float(ends[SLAM].max()) < 0.10,
        ),
        assess(
            'dead reckoning with the calibrated gyro does not',
            'by eye',
            f'error after {END_S - OFF_S:.0f} s without the camera: {_centimetres(ends[GYRO])}',
            float(ends[GYRO].mean()) > float(ends[SLAM].mean()),
        ),
    )
    return Tracks(results[0], ends, claims)


def _scenario(camera_until_s: float) -> Scenario:
    lanes = find_scenario('lanes')
    errors = replace(lanes.errors, scale_factor=1.0 - NOMINAL_ERROR)
    driving_style = replace(lanes.driving_style, area_m=(4.0, 2.5))
    return replace(
        lanes,
        duration_s=END_S + 1.0,
        camera_until_s=camera_until_s,
        errors=errors,
        driving_style=driving_style,
    )


def _camera_covered(seed: int) -> dict[str, Trajectory2D]:
    """Return the trajectories from the time on at which the camera is covered."""
    source = SimSource(_scenario(OFF_S), seed)
    run = calibrate(source, Config(), default_model())
    time_s = np.arange(OFF_S, END_S, STEP_S)
    paths = {GYRO: slam_path(run), NOMINAL: nominal_path(source, run)}
    aligned = {
        name: Trajectory2D(time_s, *aligned_to_truth(source, run, path, time_s))
        for name, path in paths.items()
    }
    return {TRUTH: _truth(source, time_s)} | aligned


def _camera_on(seed: int) -> dict[str, Trajectory2D]:
    """Return SLAM from the start with the camera on, and the dead reckoning of the other recording."""
    source = SimSource(_scenario(math.inf), seed)
    run = calibrate(source, Config(), default_model())
    time_s = np.arange(SETTLED_S, END_S, STEP_S)
    slam = Trajectory2D(time_s, *aligned_to_truth(source, run, slam_path(run), time_s))
    return {TRUTH: _truth(source, time_s), SLAM: slam, GYRO: _camera_covered(seed)[GYRO]}


def _truth(source: SimSource, time_s: Array) -> Trajectory2D:
    yaw = source.truth.trajectory.motion(time_s).euler_rad[:, 2]
    return Trajectory2D(time_s, source.truth.position(time_s)[:, :2], yaw)


def _end_errors(results: list[dict[str, Trajectory2D]]) -> dict[str, Array]:
    """Return the distances (seeds,) from the truth at the end, by name."""
    return {
        name: np.array(
            [np.linalg.norm(paths[name].position_m[-1] - paths[TRUTH].position_m[-1]) for paths in results]
        )
        for name in results[0]
        if name != TRUTH
    }


def _centimetres(values_m: Array) -> str:
    values = 100.0 * values_m
    return f'{values.mean():.1f} cm mean, {values.max():.1f} worst of {len(values)}'
