"""Fig. 7: the feature map; a rotation alone does not determine the depth of the features."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assess
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D, slam_path
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.state.map import CeilingMap, ceiling_map
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.manoeuvres import drive, rest, turn
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

FEATURES = 5
"""Number of features that are tracked at a time, as in the paper."""
DRIVEN_M, STANDING_S, RATE_RAD_S = 1.5, 3.0, math.radians(60.0)


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMap:
    """The figure."""

    ceiling: CeilingMap
    """Map of the first seed, in the frame of its start."""
    path: Trajectory2D
    corners_m: Array
    """(c, 2) true positions of the corners of the simulated ceiling, in the same frame."""
    turned_std_m: Array
    """(seeds,) median standard deviation of the heights of features after a full turn on the spot."""
    driven_std_m: Array
    """(seeds,) the same after a further 1.5 m straight on."""
    errors_m: Array
    """(m,) horizontal distance of each mapped feature of all seeds from the nearest corner."""
    errors_sigma: Array
    """(m,) the same in standard deviations by the covariance."""
    claims: tuple[Claim, ...]


def figure_7(each: Mapper, seeds: int) -> FeatureMap:
    """Map the ceiling in two minutes of lanes; measure the depths after a turn and after a straight drive."""
    maps = list(each(_lanes, list(range(seeds))))
    stds = np.array(list(each(_turn_then_drive, list(range(seeds)))))
    ceiling, path, corners, _ = maps[0]
    errors_m, errors_sigma = np.concatenate([errors for _, _, _, errors in maps]).T
    turned, driven = stds.T
    inside = [100.0 * float(np.mean(errors_sigma < sigmas)) for sigmas in (1.0, 3.0)]
    claims = (
        assess(
            'a rotation alone does not determine the depth',
            'stated, not measured',
            f'after a full turn each height is known to {_metres(turned)}, hardly better than the prior',
            bool(np.median(turned) > 0.5),
        ),
        assess(
            'forward motion determines it',
            'stated, not measured',
            f'after {DRIVEN_M:g} m more to {_metres(driven)}',
            bool(np.median(driven) < 0.1 * np.median(turned)),
        ),
        assess(
            'the ellipses are bounds of 1 sigma',
            'drawn as such',
            f'{inside[0]:.0f} % of {len(errors_sigma)} features are inside theirs (39 % would be right), '
            f'{inside[1]:.0f} % within 3 sigma (99 %); median error {1e3 * np.median(errors_m):.1f} mm',
            inside[1] > 95.0,
        ),
    )
    return FeatureMap(ceiling, path, corners, turned, driven, errors_m, errors_sigma, claims)


def _lanes(seed: int) -> tuple[CeilingMap, Trajectory2D, Array, Array]:
    """Return map, path, true corners, and errors in m and in sigma, in the frame of the map."""
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
    """Return the standard deviation of the heights after a turn on the spot, and after a straight drive.

    The camera is over the turning centre on a level floor: otherwise a turn moves it and gives parallax.
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
    return _height_std_m(scenario, seed, turned_s), _height_std_m(scenario, seed, driven_s)


def _height_std_m(scenario: Scenario, seed: int, until_s: float) -> float:
    run = calibrate(SimSource(replace(scenario, duration_s=until_s), seed), Config(), default_model())
    ceiling = ceiling_map(run.state, run.config.features.parametrisation)
    return float(np.sqrt(np.median(ceiling.covariances_m2[ceiling.in_view, 2, 2])))


def _metres(values_m: Array) -> str:
    return f'{np.median(values_m):.2g} m ({values_m.min():.2g} to {values_m.max():.2g})'
