"""A way that may be noise of the wheels tells neither how far the ceiling is nor what the wheels lack."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contracts import eventful_block
from filter_states import INVERSE_DEPTH, some_state

from gyrocal_ros.config.sections import Config, WheelConfig
from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf import image_update
from gyrocal_ros.ekf.features.certain_way import at_certain_way, is_certain, without_way
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.camera import mount_from_yaw
from gyrocal_ros.model.features.base import PosedCamera, Prediction, posed_camera
from gyrocal_ros.sim.scenarios import CAMERA, find_scenario
from gyrocal_ros.sim.scene import Scene, draw_scene
from gyrocal_ros.sim.world import SimSource

DEPTH_M = 2.4
LEVER_M = 0.03
SETTINGS = WheelConfig(distance_noise_m=0.004, turn_noise_m=0.002)
NOISE_M = np.array([0.002, -0.001, 0.0])


@pytest.mark.parametrize(
    ('way_m', 'turn_rad', 'expected'),
    [
        (0.03, 0.0, True),
        (-0.03, 0.2, True),
        (0.0, 0.2, True),  # no noise either
        (0.0043, 0.2, False),  # 5 sigma of 0.93 mm
        (-0.0043, -0.2, False),
        (0.0051, 0.2, True),
        (3e-4, 0.0, False),  # 5 sigma of 0.07 mm
        (5e-4, 0.0, True),
    ],
)
def test_a_way_is_certain_beyond_the_noise_of_the_wheels(
    way_m: float, turn_rad: float, expected: bool
) -> None:
    block = eventful_block()
    rates, count = np.zeros((len(block.dt_s), 3)), len(block.dt_s)
    rates[:, 2] = turn_rad / block.dt_s.sum()
    driven = replace(block, distance_m=np.full(count, way_m / count), rate_rad_s=rates)
    assert is_certain(driven, SETTINGS) == expected
    stays = without_way(driven)
    assert not stays.distance_m.any() and stays.rate_rad_s is rates


def predicted(state: State, rows: IntArray, position_m: Array) -> tuple[PosedCamera, Prediction]:
    mount = mount_from_yaw(0.09, 0.0, 0.1, -90.0)
    view = posed_camera(CAMERA, mount, position_m, state.euler_rad)
    return view, INVERSE_DEPTH.predict(view, state.features[rows], state.anchors_of(rows))


def test_derivatives_by_known_depths_are_those_where_the_robot_stayed() -> None:
    state, rows = some_state(), np.array([0, 2, 3])
    places = state.robot_size + 3 * rows + 2
    covariance = state.covariance.copy()
    covariance[places, places] = np.square(np.array([0.09, 0.11, 0.09]) * state.mean[places])
    state = replace(state, covariance=covariance)
    view, prediction = predicted(state, rows, state.position_m)
    _, stayed = predicted(state, rows, state.position_m - NOISE_M)
    found = at_certain_way(state, view, rows, prediction, NOISE_M)
    there, here = stayed.by_feature[:, :, 2], prediction.by_feature[:, :, 2]
    assert np.abs(there - here).max() > 0.1
    np.testing.assert_allclose(found.by_feature[[0, 2], :, 2], there[[0, 2]], atol=2e-3)
    np.testing.assert_array_equal(found.by_feature[1], prediction.by_feature[1], 'its depth is unknown')
    np.testing.assert_array_equal(found.by_feature[:, :, :2], prediction.by_feature[:, :, :2])
    assert found.expected is prediction.expected and found.by_pose is prediction.by_pose


@pytest.fixture
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ceiling at one height above the camera."""

    def drawn(*about: Any, **more: Any) -> Scene:
        scene = draw_scene(*about, **more)
        points_w = scene.points_w.copy()
        points_w[:, 2] = 0.1 + DEPTH_M
        return Scene(points_w, scene.furniture)

    monkeypatch.setattr('gyrocal_ros.sim.world.draw_scene', drawn)


def spinning(seed: int, *effects: str, seconds: float = 60.0) -> Iterator[EkfSlam]:
    """Run the filter on a robot that spins on the spot, and whose wheels are noisier than set."""
    usual = find_scenario('spins')
    errors = replace(usual.errors, pixel_noise_px=0.05, wheel_noise_m=0.0125)
    scenario = replace(
        usual,
        duration_s=seconds,
        imu_hz=100,
        camera_hz=8,
        mount_xyz_m=(LEVER_M, 0.0, 0.1),
        errors=errors,
    )
    source, model = SimSource(scenario, seed), default_model()
    for name in effects:
        model = with_effect(model, find_effect(name))
    config = Config()
    config = replace(config, camera=replace(config.camera, pixel_noise_px=errors.pixel_noise_px))
    slam = EkfSlam(model, config, source.rig)
    stream = SlamStream(slam)
    for measurement in source.measurements():
        stream.step(measurement)
        yield slam


def last(slams: Iterator[EkfSlam]) -> State:
    *_, slam = slams
    return slam.state


@pytest.mark.usefixtures('flat')
class TestSpins:
    @pytest.mark.parametrize('seed', [1, 2, 3])
    def test_do_not_make_the_ceiling_farther(self, seed: int) -> None:
        """By 7 to 8 %, with a standard deviation of 0.7 %, where the noise is in the derivative."""
        state = last(spinning(seed))
        places = state.robot_size + 2 + 3 * np.arange(len(state.landmarks.ids))
        inverse_depths, variances = state.mean[places], state.covariance[places, places]
        are_known = np.sqrt(variances) < 0.02 * inverse_depths
        error = float(np.median(DEPTH_M * inverse_depths[are_known])) - 1.0
        std = DEPTH_M * float(np.median(np.sqrt(variances[are_known])))
        assert are_known.sum() >= 8 and std < 0.01
        assert abs(error) < 2.5 * std

    def test_do_not_make_the_wheels_shorter(self) -> None:
        state = last(spinning(2, 'wheel_scale'))
        place = state.coefficient_columns.start + 1
        assert abs(state.mean[place]) < 3.0 * np.sqrt(state.covariance[place, place])

    def test_the_noise_is_that_since_the_last_image(self, monkeypatch: pytest.MonkeyPatch) -> None:
        seen_m = []

        def noted(state: State, view: PosedCamera, rows: IntArray, *about: Any) -> Prediction:
            seen_m.append(float(np.linalg.norm(about[1])))
            return at_certain_way(state, view, rows, *about)

        monkeypatch.setattr(image_update, 'at_certain_way', noted)
        last(spinning(1, seconds=20.0))
        assert len(seen_m) > 50 and 2e-4 < np.mean(seen_m) < 0.005
