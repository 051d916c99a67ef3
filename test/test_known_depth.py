"""A depth that becomes known tells nothing of where the robot is, nor of the size of its map."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from filter_states import INVERSE_DEPTH, some_state

from gyrocal_ros.config.sections import Config, FeatureConfig
from gyrocal_ros.data import Array, TruthSample
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.features.known_depth import TellingWay, directions_by_pose, relative_growth
from gyrocal_ros.ekf.features.landmarks import with_shared_errors
from gyrocal_ros.ekf.history.run import History
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.camera import mount_from_yaw
from gyrocal_ros.model.features.base import anchors_at, posed_camera
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import CAMERA, find_scenario
from gyrocal_ros.sim.world import SimSource

MOUNT = mount_from_yaw(0.09, 0.0, 0.1, -90.0)
RNG = np.random.default_rng(4)
PATCH_NOISE_PX = 0.05
"""Noise of the pixels of a good tracker: the smaller, the more a wrong share tells."""


def test_what_is_shared_is_the_product_with_a_matrix() -> None:
    state = some_state()
    places, causes = state.feature_columns(np.array([1, 3])).ravel(), np.array([0, 4, 9])
    by_causes = RNG.normal(size=(6, 3))
    matrix = np.eye(len(state.mean))
    matrix[np.ix_(places, causes)] = by_causes
    shared = with_shared_errors(state, places, causes, by_causes)
    np.testing.assert_allclose(shared.covariance, matrix @ state.covariance @ matrix.T, atol=1e-12)
    np.testing.assert_allclose(shared.sensitivity, matrix @ state.sensitivity, atol=1e-12)
    np.testing.assert_array_equal(shared.mean, state.mean)


@cache
def driven(seed: int) -> tuple[History, SimSource]:
    """Return the history of a run on exact features, and its source."""
    scenario = find_scenario('cleaning')
    errors = replace(scenario.errors, pixel_noise_px=PATCH_NOISE_PX)
    source = SimSource(replace(scenario, duration_s=60.0, imu_hz=100, camera_hz=6, errors=errors), seed)
    return calibrate(source, Config(), default_model()).history, source


def test_the_map_keeps_the_size_that_the_wheels_give_it() -> None:
    errors = []
    for seed in range(1, 7):
        history, source = driven(seed)
        truth = [item for item in source.measurements() if isinstance(item, TruthSample)]
        stamps_ns = np.array([item.t_ns for item in truth], float)
        true_m = np.array([item.position_m[:2] for item in truth])
        late = history.time_s > 20.0
        there = np.column_stack([np.interp(history.t_ns, stamps_ns, column) for column in true_m.T])
        found, wanted = (path[late] - path[late].mean(axis=0) for path in (history.mean[:, :2], there))
        errors.append(np.sqrt(np.sum(found**2) / np.sum(wanted**2)) - 1.0)
    assert (
        np.sqrt(np.mean(np.square(errors))) < 0.003
    )  # by the wheels 5 mm over a metre, 1 mm per metre over 25


def test_no_image_alone_tells_the_position() -> None:
    """Between turns, images hold the position on the map; a new feature does not make it certain."""
    history, _ = driven(3)
    straight = (history.time_s > 4.0) & (history.time_s < 11.0)
    along_m = history.std[straight, 0]
    assert along_m[-1] > 0.003
    assert (np.diff(along_m) > -0.3 * along_m[:-1]).all()


def test_directions_turn_as_the_camera_moves_by_the_depth_that_changes() -> None:
    """A camera farther ahead sees a point of inverse depth r in another direction."""
    state, pixels, step = some_state(), np.array([[80.0, 60.0], [210.0, 150.0]]), 1e-6
    change = np.array([0.3, 0.5])

    def directions(pose: Array) -> Array:
        view = posed_camera(CAMERA, MOUNT, pose[:3], pose[3:])
        rays_w = np.column_stack([features[:, :2], np.ones(2)]) @ here.R_wc.T
        seen = (rays_w / change[:, None] + here.p_wc - view.p_wc) @ here.R_wc
        return seen[:, :2] / seen[:, 2:]

    here = posed_camera(CAMERA, MOUNT, state.position_m, state.euler_rad)
    features = INVERSE_DEPTH.initialise(here, pixels, 0.1, FeatureConfig()).parameters
    steps = [(directions(state.mean[:6] + step * axis) - features[:, :2]) / step for axis in np.eye(6)]
    found = directions_by_pose(features, here.R_wc.T, here, change)
    np.testing.assert_allclose(found, -np.stack(steps, axis=2), atol=1e-5)


@pytest.mark.parametrize(
    ('ways_m', 'last_seen_s', 'expected'),
    [
        ((0.45, 0.45, 0.45, 0.45, 0.45), (1, 1, 1, 1, 1), True),
        ((0.3, 0.3, 0.3, 0.3, 0.3), (1, 1, 1, 1, 1), False),
        ((0.0, 0.0, 0.45, 0.45, 0.45), (1, 1, 1, 1, 1), True),
        ((0.0, 0.0, 0.0, 0.45, 0.45), (1, 1, 1, 1, 1), False),
        ((0.0, 0.0, 0.0, 0.0, 0.45), (0, 0, 0, 0, 1), True),  # the others were not seen
        ((0.45, 0.45, 0.45, 0.45, 0.45), (0, 0, 0, 0, 0), False),
    ],
)
def test_the_camera_has_moved_by_a_part_of_the_depth(
    ways_m: tuple[float, ...], last_seen_s: tuple[int, ...], expected: bool
) -> None:
    state = some_state()
    view = posed_camera(CAMERA, MOUNT, state.position_m, state.euler_rad)
    anchors_m = view.p_wc + np.array([[0.6 * way_m, 0.8 * way_m, 0.0] for way_m in ways_m])
    landmarks = replace(
        state.landmarks,
        anchors=anchors_at(state.landmarks.anchors.R_wc, anchors_m),
        anchor_rows=np.full(5, -1),
        last_seen_ns=np.array(last_seen_s),
    )
    mean = state.mean.copy()
    mean[state.robot_size + 2 : state.anchors_start : 3] = 1.0 / 2.5
    way = TellingWay()
    way.see(replace(state, t_ns=1, mean=mean, landmarks=landmarks), view)
    assert way.tells == expected


@pytest.mark.parametrize(('effect', 'growth'), [('focal_length', -1.0), ('principal_point', 0.0)])
def test_a_longer_focal_length_makes_directions_smaller(effect: str, growth: float) -> None:
    source = SimSource(replace(find_scenario('cleaning'), duration_s=2.0), 1)
    slam = EkfSlam(with_effect(default_model(), find_effect(effect)), Config(), source.rig)
    stream = SlamStream(slam)
    for measurement in source.measurements():
        stream.step(measurement)
    rows = np.arange(len(slam.state.landmarks.ids))
    found = relative_growth(slam.state, slam._image_model(), rows)
    np.testing.assert_array_equal(found[:, 0], 0.0)  # a gyro has no image
    per_unit = 1.0 if effect == 'focal_length' else CAMERA.fx_px  # of coefficients in pixels
    np.testing.assert_allclose(per_unit * found[:, 1:], growth, atol=0.05)
