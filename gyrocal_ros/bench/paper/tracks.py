"""Figs. 12 and 13: where the robot believes to be, by dead reckoning and by SLAM.

One robot drives lanes over a room. In Fig. 12 the camera is covered after two minutes; in Fig. 13 it is
not, and the same dead reckoning is laid beside the SLAM.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.camera_off import laid_on_truth, nominal_path
from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assessed
from gyrocal_ros.bench.paper.unseen import NOMINAL_ERROR
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import Trajectory2D, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

OFF_S, END_S, STEP_S = 120.0, 300.0, 0.2
SETTLED_S = 1.0
"""The SLAM path is laid on the truth so long after the start."""


GYRO, NOMINAL, SLAM, TRUTH = 'calibrated gyro', 'nominal gyro', 'SLAM', 'ground truth'


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """One of the two figures."""

    tracks: dict[str, Trajectory2D]
    """Of the first seed by name, laid on the truth where they begin."""
    end_errors_m: dict[str, Array]
    """(seeds,) by name, distance from the truth at the end."""
    claims: tuple[Claim, ...]


def figure_12(each: Mapper, seeds: int) -> Tracks:
    """Three minutes of lanes with the camera covered."""
    results = list(each(_covered, list(range(seeds))))
    ends = _end_errors(results)
    calibrated, nominal = ends[GYRO], ends[NOMINAL]
    claims = (
        assessed(
            'end position by dead reckoning, calibrated',
            '13.8 cm',
            _centimetres(calibrated),
            float(calibrated.mean()) < 0.138,
        ),
        assessed(
            'not calibrated',
            '66.0 cm',
            f'{_centimetres(nominal)}; scale factor off by {100.0 * NOMINAL_ERROR:.2f} % as in Table 1',
            float(nominal.mean()) > 3.0 * float(calibrated.mean()),
        ),
    )
    return Tracks(results[0], ends, claims)


def figure_13(each: Mapper, seeds: int) -> Tracks:
    """The same with the camera on, and the dead reckoning of Fig. 12."""
    seen = list(each(_seen, list(range(seeds))))
    ends = _end_errors(seen)
    claims = (
        assessed(
            'SLAM stays on the ground truth',
            'to the eye',
            f'{_centimetres(ends[SLAM])} off at the end of 5 minutes',
            float(ends[SLAM].max()) < 0.10,
        ),
        assessed(
            'dead reckoning with the calibrated gyro does not',
            'to the eye',
            f'{_centimetres(ends[GYRO])} off after {END_S - OFF_S:.0f} s without the camera',
            float(ends[GYRO].mean()) > float(ends[SLAM].mean()),
        ),
    )
    return Tracks(seen[0], ends, claims)


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


def _covered(seed: int) -> dict[str, Trajectory2D]:
    """From when the camera is covered."""
    source = SimSource(_scenario(OFF_S), seed)
    run = calibrate(source, Config(), default_model())
    time_s = np.arange(OFF_S, END_S, STEP_S)
    paths = {GYRO: slam_path(run), NOMINAL: nominal_path(source, run)}
    laid = {
        name: Trajectory2D(time_s, *laid_on_truth(source, run, path, time_s)) for name, path in paths.items()
    }
    return {TRUTH: _truth(source, time_s)} | laid


def _seen(seed: int) -> dict[str, Trajectory2D]:
    """From the start, the camera on; the dead reckoning from when it is covered in the other recording."""
    source = SimSource(_scenario(math.inf), seed)
    run = calibrate(source, Config(), default_model())
    time_s = np.arange(SETTLED_S, END_S, STEP_S)
    slam = Trajectory2D(time_s, *laid_on_truth(source, run, slam_path(run), time_s))
    return {TRUTH: _truth(source, time_s), SLAM: slam, GYRO: _covered(seed)[GYRO]}


def _truth(source: SimSource, time_s: Array) -> Trajectory2D:
    yaw = source.truth.trajectory.motion(time_s).euler_rad[:, 2]
    return Trajectory2D(time_s, source.truth.position(time_s)[:, :2], yaw)


def _end_errors(results: list[dict[str, Trajectory2D]]) -> dict[str, Array]:
    """Distance from the truth at the end, by name."""
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
