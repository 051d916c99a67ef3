"""Corrections of the position and of the camera move the anchors too; no parallax comes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_states import INVERSE_DEPTH, some_state

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.moved_anchors import moved_anchors
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state import State
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.camera import mount_from_yaw
from gyrocal_ros.model.features.base import Anchors, posed_camera
from gyrocal_ros.sim.scenarios import CAMERA, Scenario, find_scenario
from gyrocal_ros.sim.trajectory import Leg
from gyrocal_ros.sim.world import SimSource

MOUNT = mount_from_yaw(0.09, 0.0, 0.1, -90.0)
TYPICAL_DEPTH_M = 2.4
"""Of a ceiling in the simulator."""
PATCH_NOISE_PX = 0.05
"""Noise of the pixels of a good tracker: the smaller, the more a false parallax tells."""
CLEANING = find_scenario('cleaning')
AHEAD = (Leg(1.0), Leg(0.5, 0.3), Leg(60.0, 0.3))


def seen_at_variances(variances_m2: Array) -> State:
    """Return a state whose features were seen first at positions of the given variances (5,)."""
    state = some_state()
    return replace(state, landmarks=replace(state.landmarks, first_variance_m2=variances_m2))


def moved(before: State, mean: Array, variance_m2: float, lever_change_m: Array) -> tuple[Array, Array]:
    """Return mean and anchors after an update that leads to a mean."""
    landmarks = before.landmarks
    return moved_anchors(
        mean,
        before.robot_size,
        before.mean,
        variance_m2,
        landmarks.first_variance_m2,
        lever_change_m,
        landmarks.anchors.R_wc,
        landmarks.anchors.p_wc,
        0.1,
    )


def pixels(mean: Array, anchors_m: Array, state: State, lever_m: Array) -> Array:
    """Return where the features are expected with a lever arm of the camera."""
    mount = replace(MOUNT, p_bs=lever_m)
    view = posed_camera(CAMERA, mount, mean[:3], mean[3:6])
    anchors = Anchors(state.landmarks.anchors.R_wc, anchors_m)
    return INVERSE_DEPTH.predict(view, mean[state.robot_size :].reshape(-1, 3), anchors).expected


def test_moved_anchors_expect_the_same_image_whatever_the_depths() -> None:
    """Robot and anchors move together, so what depths are found later does not matter."""
    state, way_m = seen_at_variances(np.ones(5)), np.array([0.03, -0.02, 0.01])
    r, anchors_m = state.robot_size, state.landmarks.anchors.p_wc
    R_aw, inverse_depths = state.landmarks.anchors.R_wc.transpose(0, 2, 1), state.features[:, 2]
    rays = np.column_stack([state.features[:, :2], np.ones(len(anchors_m))])
    corrected = state.mean.copy()
    corrected[:3] += way_m
    # the directions that show the same image from there, by fixed anchors and the depths of now
    rays = rays + inverse_depths[:, None] * (R_aw @ way_m)
    corrected[r:] = np.column_stack([rays[:, :2], inverse_depths])[:, :3].ravel() / np.repeat(rays[:, 2], 3)
    later = replace(state, mean=state.mean.copy())
    later.mean[r + 2 :: 3] *= [0.5, 0.8, 1.1, 1.6, 2.0]

    mean, moved_m = moved(state, corrected, 1.0, np.zeros(3))
    np.testing.assert_allclose(moved_m - anchors_m, np.tile(way_m, (5, 1)), atol=1e-15)
    mean[r + 2 :: 3] *= [0.5, 0.8, 1.1, 1.6, 2.0]
    expected = pixels(later.mean, anchors_m, state, MOUNT.p_bs)
    np.testing.assert_allclose(pixels(mean, moved_m, state, MOUNT.p_bs), expected, atol=0.35)
    fixed = corrected.copy()
    fixed[r + 2 :: 3] *= [0.5, 0.8, 1.1, 1.6, 2.0]
    assert np.abs(pixels(fixed, anchors_m, state, MOUNT.p_bs) - expected).max() > 2.0


def test_an_anchor_moves_by_the_share_of_the_error_that_it_had() -> None:
    state = seen_at_variances(np.array([0.0, 1.0, 2.0, 4.0, 8.0]))
    corrected = state.mean.copy()
    corrected[0] += 0.01
    _, anchors_m = moved(state, corrected, 4.0, np.zeros(3))
    ways_m = (anchors_m - state.landmarks.anchors.p_wc)[:, 0]
    np.testing.assert_allclose(ways_m, [0.0, 0.0025, 0.005, 0.01, 0.01])
    _, unmoved_m = moved(state, corrected, 0.0, np.zeros(3))
    np.testing.assert_array_equal(unmoved_m, state.landmarks.anchors.p_wc)


def test_a_camera_elsewhere_on_the_robot_was_elsewhere_at_the_first_sight() -> None:
    state, lever_change_m = some_state(), np.array([0.004, -0.01, 0.002])
    _, anchors_m = moved(state, state.mean, 1.0, lever_change_m)
    expected_m = state.landmarks.anchors.p_wc + state.landmarks.anchors.R_wc @ lever_change_m
    np.testing.assert_allclose(anchors_m, expected_m, atol=1e-15)


def filtered(scenario: Scenario, effect: str, depth_m: float, seed: int = 4) -> State:
    """Return the state after a drive that hides nothing, with an effect in the model.

    Args:
        scenario: the drive.
        effect: name of the effect.
        depth_m: depth that the filter expects.
        seed: of the recording.
    """
    config, errors = Config(), replace(scenario.errors, pixel_noise_px=PATCH_NOISE_PX)
    config = replace(
        config,
        camera=replace(config.camera, pixel_noise_px=PATCH_NOISE_PX),
        features=replace(config.features, prior_depth_m=depth_m),
    )
    source = SimSource(replace(scenario, errors=errors), seed)
    slam = EkfSlam(with_effect(default_model(), find_effect(effect)), config, source.rig)
    stream = SlamStream(slam)
    for measurement in source.measurements():
        stream.step(measurement)
    return slam.state


def estimate(state: State) -> tuple[Array, Array]:
    """Return the coefficients of the effect and their standard deviations."""
    std = np.sqrt(state.covariance.diagonal()[state.coefficient_columns])
    return state.coefficients[1:], std[1:]


def test_a_robot_at_rest_does_not_learn_how_far_the_ceiling_is() -> None:
    """Before the first sample of the wheels, 5 mm are not known; they are those of the whole map."""
    scenario = replace(CLEANING, duration_s=3.0, standing_s=60.0)
    state, prior = filtered(scenario, 'wheel_scale', 1.6), Config().features.prior_inverse_depth_std
    places = state.feature_columns(np.arange(10))[:, 2]
    stds = np.sqrt(state.covariance.diagonal()[places])
    assert stds.min() > 0.9 * prior
    assert np.abs(state.mean[places] - 1.0 / 1.6).max() < 0.3 * prior


@pytest.mark.parametrize('depth_m', [1.6, TYPICAL_DEPTH_M])
def test_no_straight_way_tells_the_size_of_the_wheels(depth_m: float) -> None:
    """Only thresholds do, which tilt the robot."""
    ahead = replace(CLEANING, duration_s=12.0, legs=AHEAD, bumps=0)
    value, std = estimate(filtered(ahead, 'wheel_scale', depth_m))
    (item,) = find_effect('wheel_scale').coefficients
    assert std[0] > 0.95 * item.prior_std and abs(value[0]) < 0.3 * item.prior_std


@pytest.mark.parametrize('effect', ['wheel_scale', 'camera_position', 'focal_length'])
def test_effects_of_the_camera_do_not_depend_on_the_depth_that_is_expected(effect: str) -> None:
    scenario = replace(CLEANING, duration_s=30.0)
    near, _ = estimate(filtered(scenario, effect, 1.6))
    usual, std = estimate(filtered(scenario, effect, TYPICAL_DEPTH_M))
    assert (np.abs(usual) < 3.0 * std).all()
    assert (np.abs(near - usual) < std).all()
