"""Prediction: mean, transition and process noise against differences, dense matrices and Monte Carlo."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contracts import differences, eventful_block, half_slow_block
from filter_states import (
    CANDIDATES,
    EFFECTS,
    MODEL,
    QUIET_GYRO,
    QUIET_WHEELS,
    SCALES,
    dense_transition,
    some_state,
    step,
)

from gyrocal_ros.config.sections import Config, GyroConfig, WheelConfig
from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.rate_deadband import INSIDE_STD
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.predict import (
    MISALIGNMENT_RAD,
    SLOW_TILT_RAD_S,
    FilterModel,
    predict,
    predict_sensitivity,
)
from gyrocal_ros.ekf.state.layout import BIAS, EULER, POSE, POSITION, YAW
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.kinematics import integrate
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import SensorModel


def added_noise(
    block: MotionBlock, gyro: GyroConfig, wheels: WheelConfig, model: SensorModel = MODEL
) -> Array:
    """Return the covariance that prediction adds to a state that was known exactly."""
    state = replace(initial_state(model, Config(), None), t_ns=block.start_ns)
    state = replace(state, covariance=np.zeros_like(state.covariance))
    return step(state, block, gyro, wheels, model)[0].covariance


@pytest.mark.parametrize('bias', [BiasModel(), BiasModel('settling', 50.0, 0.01)], ids=lambda bias: bias.form)
def test_transition_is_the_derivative_of_the_prediction(bias: BiasModel) -> None:
    state, block, model = some_state(), eventful_block(), replace(MODEL, bias=bias)
    after, transition = step(state, block, model=model)
    r = state.robot_size
    steps = np.concatenate([np.full(9, 1e-6), 1e-3 * SCALES])

    def robot_after(robot: Array) -> Array:
        mean = np.concatenate([robot, state.mean[r:]])
        return step(replace(state, mean=mean), block, model=model)[0].mean[:r]

    expected = differences(robot_after, state.mean[:r], steps)
    np.testing.assert_allclose(transition.matrix, expected, atol=1e-4)
    np.testing.assert_allclose(transition.matrix[YAW], expected[YAW], rtol=1e-4, atol=2e-6)
    np.testing.assert_array_equal(after.mean[r:], state.mean[r:])
    assert after.t_ns == block.end_ns


def test_predicted_covariance_agrees_with_dense_matrices() -> None:
    state, block = some_state(), eventful_block()
    matrix = dense_transition(state, block)
    np.testing.assert_allclose(
        step(state, block)[0].covariance, matrix @ state.covariance @ matrix.T, rtol=1e-9, atol=1e-15
    )


def test_process_noise_acts_on_the_robot_alone() -> None:
    state, block = some_state(), eventful_block()
    noisy, quiet = step(state, block, GyroConfig(), WheelConfig())[0], step(state, block)[0]
    noise = noisy.covariance - quiet.covariance
    r = state.robot_size
    np.testing.assert_array_equal(noise[r:], 0.0)
    np.testing.assert_array_equal(noise[:, r:], 0.0)
    assert np.linalg.eigvalsh(noise[:9, :9]).min() > 0.0


@pytest.mark.slow
def test_gyro_noise_agrees_with_monte_carlo() -> None:
    """A density d makes the mean over an interval dt scatter by d / sqrt(dt)."""
    block, gyro = eventful_block(), replace(QUIET_GYRO, rate_noise_deg_s=0.5)
    density = math.radians(gyro.rate_noise_deg_s)
    rng = np.random.default_rng(0)
    ends = []
    for _ in range(6000):
        noise = density / np.sqrt(block.dt_s)[:, None] * rng.standard_normal(block.rate_rad_s.shape)
        motion = integrate(np.zeros(3), np.zeros(3), block.rate_rad_s + noise, block.dt_s, block.distance_m)
        ends.append(np.concatenate([motion.position_m, motion.euler_rad]))
    sampled = np.cov(np.array(ends).T)
    expected = added_noise(block, gyro, QUIET_WHEELS)[POSE, POSE]
    std = np.sqrt(np.diagonal(expected))[1:]  # forwards the noise acts in second order only
    np.testing.assert_allclose(
        sampled[1:, 1:] / np.outer(std, std), expected[1:, 1:] / np.outer(std, std), atol=0.06
    )


def test_wheel_noise_has_the_axes_of_the_robot() -> None:
    wheels = WheelConfig(
        distance_noise_m=0.01, lateral_noise_m=0.02, vertical_noise_m=0.003, turn_noise_m=0.0
    )
    block = replace(eventful_block(), rate_rad_s=np.zeros((12, 3)), distance_m=np.full(12, -0.05))
    state = replace(initial_state(MODEL, Config(), None), t_ns=block.start_ns)
    state.mean[EULER] = [0.1, -0.2, 1.0]
    state = replace(state, covariance=np.zeros_like(state.covariance))
    R_wb = rotation_from_euler(state.euler_rad)
    noise = R_wb.T @ step(state, block, wheels=wheels)[0].covariance[POSITION, POSITION] @ R_wb
    np.testing.assert_allclose(noise, 0.6 * np.diag([0.01**2, 0.02**2, 0.003**2]), atol=1e-12)


def test_turning_adds_position_noise_in_the_plane() -> None:
    wheels = replace(QUIET_WHEELS, turn_noise_m=0.002)
    block = replace(eventful_block(), distance_m=np.zeros(12))
    turned = np.abs(block.rate_rad_s[:, 2]) @ block.dt_s
    noise = added_noise(block, QUIET_GYRO, wheels)[POSITION, POSITION]
    assert noise[0, 0] == pytest.approx(0.002**2 * turned, rel=1e-3)
    assert noise[2, 2] < 1e-3 * noise[0, 0]


def test_random_walks_grow_with_time() -> None:
    coefficient = replace(find_effect('scale_factor').coefficients[0], walk=1e-4)
    effect = replace(find_effect('scale_factor'), coefficients=(coefficient,))  # type: ignore[type-var]
    model = replace(MODEL, effects=(effect,))
    gyro, block = replace(QUIET_GYRO, bias_walk_deg_s=0.01), eventful_block()
    noise = np.diagonal(added_noise(block, gyro, QUIET_WHEELS, model))
    np.testing.assert_allclose(noise[BIAS], math.radians(0.01) ** 2 * block.duration_s)
    assert noise[9] == pytest.approx(1e-8 * block.duration_s)


def test_another_rate_leaves_the_biases_of_the_x_and_y_gyros_less_known() -> None:
    block, effects = eventful_block(), sort_effects(MODEL.effects)
    state = replace(initial_state(MODEL, Config(), None), t_ns=block.start_ns)
    model = FilterModel(MODEL, effects, QUIET_GYRO, QUIET_WHEELS)
    before, after = (
        predict(state, block, replace(model, rate_change_rad_s=change), effects.no_memories())[0]
        for change in (0.0, -0.5)
    )
    added = (after.covariance - before.covariance).diagonal()[BIAS]
    np.testing.assert_allclose(added, [(0.5 * MISALIGNMENT_RAD) ** 2] * 2 + [0.0], rtol=1e-6)


def test_the_x_and_y_gyros_miss_a_part_of_a_tilt() -> None:
    """Of a turn about x or y, as a whole; their noise, which changes sign, adds nothing."""
    tilting = replace(eventful_block(), rate_rad_s=np.tile([0.3, -0.2, 0.0], (12, 1)))
    level = replace(initial_state(MODEL, Config(), None), t_ns=tilting.start_ns)
    assert np.all(level.euler_rad == 0.0) and np.all(level.bias_rad_s == 0.0)
    gyro = replace(QUIET_GYRO, tilt_scale_std=0.1)
    noise = added_noise(tilting, gyro, QUIET_WHEELS)[EULER, EULER]
    tilt_rad = np.maximum([0.3 - SLOW_TILT_RAD_S, 0.2 - SLOW_TILT_RAD_S, 0.0], 0.0) * tilting.dt_s.sum()
    # The second half of the tilt turns about axes that the first has tilted.
    np.testing.assert_allclose(np.sqrt(noise.diagonal()), 0.1 * tilt_rad, rtol=0.01, atol=1e-3)
    slow = replace(tilting, rate_rad_s=tilting.rate_rad_s * 0.9 * SLOW_TILT_RAD_S / 0.3)
    assert np.abs(added_noise(slow, gyro, QUIET_WHEELS)[EULER, EULER]).max() < 1e-12
    shaking = replace(
        tilting, dt_s=np.full(12, 0.01), rate_rad_s=tilting.rate_rad_s * (-1.0) ** np.arange(12)[:, None]
    )
    assert np.abs(added_noise(shaking, gyro, QUIET_WHEELS)[EULER, EULER]).max() < 1e-12


def test_gaps_add_covariance() -> None:
    block = replace(eventful_block(), gap_s=2.0, wheel_gap_s=0.5)
    noise = added_noise(block, QUIET_GYRO, QUIET_WHEELS)
    np.testing.assert_allclose(noise[EULER, EULER], math.radians(80.0) ** 2 * np.eye(3))
    np.testing.assert_allclose(np.diagonal(noise)[:2], 0.25**2, rtol=1e-6)


def test_a_dead_band_adds_covariance_to_the_heading() -> None:
    effect: Any = find_effect('rate_deadband')
    limit = replace(effect.coefficients[0], prior_mean=0.5)
    effect = replace(effect, coefficients=(limit,))
    block, model = half_slow_block(), replace(MODEL, effects=(find_effect('scale_factor'), effect))
    noise = added_noise(block, QUIET_GYRO, QUIET_WHEELS, model)
    inside = effect.contribute(block, np.array([0.5]), None).blind
    assert inside is not None and 0 < inside.sum() < 12
    assert noise[YAW, YAW] == pytest.approx((INSIDE_STD * 0.5 * block.dt_s[inside].sum()) ** 2)


def test_sensitivity_is_predicted_with_the_state() -> None:
    """It becomes `F X`, plus the derivative of what the candidates would have added in this block."""
    state, block, candidates = some_state(), eventful_block(), sort_effects(CANDIDATES)
    after, transition = step(state, block)
    carried, memories = predict_sensitivity(after, transition, block, candidates, candidates.no_memories())
    larger = replace(MODEL, effects=(*EFFECTS, *CANDIDATES))
    r = state.robot_size

    def mean_after(values: Array) -> Array:
        robot = np.concatenate([state.mean[:r], values])
        grown = replace(initial_state(larger, Config(), None), t_ns=state.t_ns, mean=robot)
        return step(grown, block, model=larger)[0].mean[:r]

    added = differences(mean_after, candidates.prior_means, 1e-5)
    expected = dense_transition(state, block) @ state.sensitivity
    expected[:r] += added
    np.testing.assert_allclose(carried.sensitivity, expected, atol=2e-5)
    assert len(memories) == len(candidates.gyro)


def test_no_candidate_acts_where_one_leaves_the_readings_blind() -> None:
    effect: Any = find_effect('rate_deadband')
    limit = replace(effect.coefficients[0], prior_mean=0.5)
    state, block, gyro = some_state(), half_slow_block(), find_effect('scale_asymmetry')
    others = state.sensitivity.shape[1] - 2
    candidates = sort_effects((replace(effect, coefficients=(limit,)), gyro), more=others)
    after, transition = step(state, block)
    outside = np.abs(block.rate_rad_s[:, 2]) >= 0.5
    assert 0 < outside.sum() < 12
    carried, _ = predict_sensitivity(after, transition, block, candidates, candidates.no_memories())
    expected = transition.yaw_gain[:, outside] @ np.abs(block.rate_rad_s[outside, 2])
    added = carried.sensitivity[POSE, 1] - after.sensitivity[POSE, 1]
    np.testing.assert_allclose(added, expected, atol=1e-12)
