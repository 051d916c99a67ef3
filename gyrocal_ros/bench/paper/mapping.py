"""Fig. 7: the feature map, and that a rotation alone does not tell how far the features are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assessed
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import Trajectory2D, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.map import CeilingMap, ceiling_map
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.manoeuvres import drive, rest, turn
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

FEATURES = 5
"""As many as the paper follows at a time."""
DRIVEN_M, STANDING_S, RATE_RAD_S = 1.5, 3.0, math.radians(60.0)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMap:
    """The figure."""

    ceiling: CeilingMap
    """Of the first seed, in the frame of its start."""
    path: Trajectory2D
    corners_m: Array
    """(c, 2) where the corners of the simulated ceiling truly are, in the same frame."""
    turned_std_m: Array
    """(seeds,) median doubt of the features' heights after a full turn on the spot."""
    driven_std_m: Array
    """(seeds,) after a straight way of 1.5 m more."""
    errors_m: Array
    """(m,) distance of each mapped feature of all seeds from the nearest corner on the floor plan."""
    errors_sigma: Array
    """(m,) the same by its covariance."""
    claims: tuple[Claim, ...]


def figure_7(each: Mapper, seeds: int) -> FeatureMap:
    """A map of the ceiling after two minutes of lanes; and a turn on the spot before a straight way."""
    maps = list(each(_lanes, list(range(seeds))))
    doubts = np.array(list(each(_turn_then_drive, list(range(seeds)))))
    ceiling, path, corners, _ = maps[0]
    errors_m, errors_sigma = np.concatenate([errors for _, _, _, errors in maps]).T
    turned, driven = doubts.T
    inside = [100.0 * float(np.mean(errors_sigma < sigmas)) for sigmas in (1.0, 3.0)]
    claims = (
        assessed(
            'the depth cannot be told by a rotation alone',
            'said, not measured',
            f'after a full turn each height is known to {_metres(turned)}, hardly better than was assumed',
            bool(np.median(turned) > 0.5),
        ),
        assessed(
            'it is told when the robot moves forward',
            'said, not measured',
            f'after {DRIVEN_M:g} m more to {_metres(driven)}',
            bool(np.median(driven) < 0.1 * np.median(turned)),
        ),
        assessed(
            'the ellipses are bounds of 1 sigma',
            'drawn as such',
            f'{inside[0]:.0f} % of {len(errors_sigma)} features lie inside theirs (39 % would be right), '
            f'{inside[1]:.0f} % within 3 sigma (99 %); median error {1e3 * np.median(errors_m):.1f} mm',
            inside[1] > 95.0,
        ),
    )
    return FeatureMap(ceiling, path, corners, turned, driven, errors_m, errors_sigma, claims)


def _lanes(seed: int) -> tuple[CeilingMap, Trajectory2D, Array, Array]:
    """Map, path, true corners, errors in m and in sigma; in the body's frame at the start, the map's own."""
    scenario = replace(find_scenario('lanes'), duration_s=120.0, features=FEATURES)
    source = SimSource(scenario, seed)
    run = calibrate(source, Config(), default_model())
    ceiling, start = ceiling_map(run.state, run.config.features.parametrisation), np.zeros(1)
    R_wb = source.truth.trajectory.motion(start).R_wb[0]
    corners = ((source.truth.scene.points_w - source.truth.position(start)) @ R_wb)[:, :2]
    apart = ceiling.points_m[:, None, :2] - corners
    nearest = apart[np.arange(len(apart)), np.argmin(np.linalg.norm(apart, axis=2), axis=1)]
    solved = np.linalg.solve(ceiling.covariances_m2[:, :2, :2], nearest[:, :, None])[:, :, 0]
    squared = [np.sum(nearest * nearest, axis=1), np.sum(nearest * solved, axis=1)]
    return ceiling, slam_path(run), corners, np.sqrt(np.stack(squared, axis=1))


def _turn_then_drive(seed: int) -> tuple[float, float]:
    """Doubt of the heights after a turn on the spot, and after a straight way that follows.

    The camera sits over the turning centre on a level floor: else a turn moves it, and that tells
    something.
    """
    turning, driving = turn(2.0 * math.pi, RATE_RAD_S), drive(DRIVEN_M, 0.3)
    scenario = replace(
        find_scenario('lanes'),
        legs=(*turning, *rest(0.5), *driving, *rest(5.0)),
        standing_s=STANDING_S,
        features=FEATURES,
        mount_xyz_m=(0.0, 0.0, 0.1),
        floor_tilt_deg=0.0,
        bumps=0,
    )
    turned_s = STANDING_S + 0.4 + sum(leg.duration_s for leg in turning)
    driven_s = turned_s + 0.2 + sum(leg.duration_s for leg in driving)
    return _doubt_m(scenario, seed, turned_s), _doubt_m(scenario, seed, driven_s)


def _doubt_m(scenario: Scenario, seed: int, until_s: float) -> float:
    run = calibrate(SimSource(replace(scenario, duration_s=until_s), seed), Config(), default_model())
    ceiling = ceiling_map(run.state, run.config.features.parametrisation)
    return float(np.sqrt(np.median(ceiling.covariances_m2[ceiling.in_view, 2, 2])))


def _metres(values_m: Array) -> str:
    return f'{np.median(values_m):.2g} m ({values_m.min():.2g} to {values_m.max():.2g})'
