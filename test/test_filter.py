"""The filter's algebra against textbook references on whole, dense matrices."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import (
    FEATURES,
    LATER_POSE,
    NOISE_PX,
    PIXELS,
    assert_positive_definite,
    differences,
    eventful_block,
    view_at,
)
from scipy.stats import chi2  # type: ignore[import-untyped]

from gyrocal_ros.config.sections import Config, GyroConfig, WheelConfig
from gyrocal_ros.data import Array, IntArray, MotionBlock
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.effects_by_place import sort_effects
from gyrocal_ros.ekf.gating import AdaptiveNoise, chi_square_quantile, inliers
from gyrocal_ros.ekf.landmarks import augment, count_matches, evict_oldest, forget_all, keep
from gyrocal_ros.ekf.predict import Transition, predict, predict_sensitivity
from gyrocal_ros.ekf.start import Start, inflate_after_gap, initial_state
from gyrocal_ros.ekf.state import BIAS, EULER, POSE, POSITION, YAW, YAW_BIAS, State
from gyrocal_ros.ekf.update import (
    Innovation,
    UpdateStats,
    heading_update,
    innovate,
    mahalanobis,
    own_precisions,
    update,
    zero_rate_update,
)
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import Parametrisation
from gyrocal_ros.model.kinematics import integrate
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.model.sensor import SensorModel

EFFECTS = tuple(
    map(
        find_effect,
        ('scale_factor', 'scale_cubic', 'bias_warmup', 'turn_slip', 'lateral_drift', 'camera_time_offset'),
    )
)
CANDIDATES = tuple(map(find_effect, ('scale_asymmetry', 'turn_hysteresis', 'wheel_scale', 'principal_point')))
MODEL = SensorModel('test', BiasModel(), EFFECTS)
VALUES = np.array([-0.07, 0.002, 0.01, 300.0, 0.0, 0.01, -0.02, 0.01])
SCALES = np.array([0.01, 0.001, 0.003, 40.0, 0.01, 0.005, 0.005, 0.003])
"""Coefficients of the model, and how well they are known. There is no turn slip for the moment: its
derivative by the turn, times how well that is known, is of second order and left out."""
K, C = len(VALUES), 6
INVERSE_DEPTH = PARAMETRISATIONS['inverse_depth']
QUIET_GYRO = replace(GyroConfig(), rate_noise_deg_s=0.0, bias_walk_deg_s=0.0)
QUIET_WHEELS = WheelConfig(0.0, 0.0, 0.0, 0.0)


def some_state(form: Parametrisation = INVERSE_DEPTH, seed: int = 0, t_ns: int = 30_000_000_000) -> State:
    """A state in the middle of a run: five features, everything correlated with everything."""
    rng = np.random.default_rng(seed)
    state = initial_state(MODEL, Config(), None, C)
    mean = np.concatenate([LATER_POSE, [0.001, -0.002, 0.003], VALUES])
    state = replace(state, t_ns=t_ns, mean=mean)
    new = form.initialise(view_at(LATER_POSE), PIXELS, NOISE_PX, FEATURES)
    state = augment(state, np.array([3, 1, 4, 15, 9]), new, None, None)
    scale = np.concatenate([[0.02] * 3, [0.003] * 3, [1e-4] * 3, SCALES, [0.02] * 15])
    mixing = scale[:, None] * rng.normal(size=(len(scale), len(scale))) / math.sqrt(len(scale))
    covariance = mixing @ mixing.T + np.diag((0.1 * scale) ** 2)
    return replace(state, covariance=covariance, sensitivity=rng.normal(size=(len(scale), C)))


# --- prediction ---------------------------------------------------------------------------------


def step(
    state: State,
    block: MotionBlock,
    gyro: GyroConfig = QUIET_GYRO,
    wheels: WheelConfig = QUIET_WHEELS,
    model: SensorModel = MODEL,
    extra_yaw_walk: float = 0.0,
) -> tuple[State, Transition]:
    parts = sort_effects(model.effects)
    return predict(state, block, model, parts, parts.no_memories(), gyro, wheels, extra_yaw_walk)


def dense_transition(state: State, block: MotionBlock) -> Array:
    matrix = np.eye(len(state.mean))
    matrix[: state.robot_size, : state.robot_size] = step(state, block)[1].matrix
    return matrix


def added_noise(
    block: MotionBlock, gyro: GyroConfig, wheels: WheelConfig, model: SensorModel = MODEL
) -> Array:
    """What prediction adds to the covariance of a state that was known exactly."""
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


def test_prediction_of_the_covariance_is_that_of_dense_matrices() -> None:
    state, block = some_state(), eventful_block()
    matrix = dense_transition(state, block)
    np.testing.assert_allclose(
        step(state, block)[0].covariance, matrix @ state.covariance @ matrix.T, rtol=1e-9, atol=1e-15
    )


def test_prediction_noise_touches_the_robot_alone() -> None:
    state, block = some_state(), eventful_block()
    noisy, quiet = step(state, block, GyroConfig(), WheelConfig())[0], step(state, block)[0]
    noise = noisy.covariance - quiet.covariance
    r = state.robot_size
    np.testing.assert_array_equal(noise[r:], 0.0)
    np.testing.assert_array_equal(noise[:, r:], 0.0)
    assert np.linalg.eigvalsh(noise[:9, :9]).min() > 0.0


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


def test_turning_moves_the_turning_centre() -> None:
    wheels = replace(QUIET_WHEELS, turn_noise_m=0.002)
    block = replace(eventful_block(), distance_m=np.zeros(12))
    turned = np.abs(block.rate_rad_s[:, 2]) @ block.dt_s
    noise = added_noise(block, QUIET_GYRO, wheels)[POSITION, POSITION]
    assert noise[0, 0] == pytest.approx(0.002**2 * turned, rel=1e-3)
    assert noise[2, 2] < 1e-3 * noise[0, 0]


def test_walks_grow_with_time() -> None:
    coefficient = replace(find_effect('scale_factor').coefficients[0], walk=1e-4)
    effect = replace(find_effect('scale_factor'), coefficients=(coefficient,))  # type: ignore[type-var]
    model = replace(MODEL, effects=(effect,))
    gyro, block = replace(QUIET_GYRO, bias_walk_deg_s=0.01), eventful_block()
    noise = np.diagonal(added_noise(block, gyro, QUIET_WHEELS, model))
    np.testing.assert_allclose(noise[BIAS], math.radians(0.01) ** 2 * block.duration_s)
    assert noise[9] == pytest.approx(1e-8 * block.duration_s)
    state = replace(initial_state(model, Config(), None), t_ns=block.start_ns)
    with_walk, _ = step(state, block, model=model, extra_yaw_walk=0.1)
    without, _ = step(state, block, model=model)
    grown = with_walk.covariance - without.covariance
    assert grown[YAW, YAW] == pytest.approx(0.01 * block.duration_s)
    assert np.count_nonzero(grown) == 1


def test_what_nobody_saw_is_in_doubt() -> None:
    block = replace(eventful_block(), gap_s=2.0, wheel_gap_s=0.5)
    noise = added_noise(block, QUIET_GYRO, QUIET_WHEELS)
    np.testing.assert_allclose(noise[EULER, EULER], math.radians(80.0) ** 2 * np.eye(3))
    np.testing.assert_allclose(np.diagonal(noise)[:2], 0.25**2, rtol=1e-6)


def test_blind_sensors_put_the_heading_in_doubt() -> None:
    effect = find_effect('rate_deadband')
    limit = replace(effect.coefficients[0], prior_mean=0.5)
    effect = replace(effect, coefficients=(limit,))  # type: ignore[type-var]
    block, model = eventful_block(), replace(MODEL, effects=(find_effect('scale_factor'), effect))
    noise = added_noise(block, QUIET_GYRO, QUIET_WHEELS, model)
    hidden_s = block.dt_s[np.abs(block.rate_rad_s[:, 2]) < 0.5].sum()
    assert noise[YAW, YAW] == pytest.approx((0.5 / math.sqrt(3.0) * hidden_s) ** 2)


def test_sensitivity_goes_with_the_prediction() -> None:
    """`F X` of what was, and what the candidates would have added in this block."""
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


# --- updates ------------------------------------------------------------------------------------


def seen(form: Parametrisation, rows: IntArray, seed: int = 1) -> tuple[State, Innovation]:
    """A state and the innovation of some of its features."""
    state, rng = some_state(form), np.random.default_rng(seed)
    view = view_at(state.mean[POSE])
    prediction = form.predict(view, state.features[rows], state.landmarks.anchors[rows])
    measured, noise = form.measure(view, PIXELS[rows] + rng.normal(size=(len(rows), 2)), NOISE_PX, FEATURES)
    by_values, by_candidates = derivatives(rows, form.rows)
    return state, innovate(state, rows, prediction, measured, noise, by_values, by_candidates)


def derivatives(rows: IntArray, width: int) -> tuple[Array, Array]:
    """Of the predictions, by the model's coefficients and by those of candidates."""
    rng = np.random.default_rng(7)
    return (rng.normal(size=(5, width, K)) / SCALES)[rows], rng.normal(size=(5, width, C))[rows]


def assert_textbook(
    before: State,
    after: State,
    lesson: UpdateStats,
    jacobian: Array,
    residual: Array,
    noise: Array,
    by_candidates: Array,
) -> None:
    """It is the Kalman update, covariance in Joseph's form, and the candidates' part in it."""
    covariance = before.covariance
    whole = jacobian @ covariance @ jacobian.T + noise
    gain = covariance @ jacobian.T @ np.linalg.inv(whole)
    left = np.eye(len(before.mean)) - gain @ jacobian
    expected = left @ covariance @ left.T + gain @ noise @ gain.T
    sensitivity = jacobian @ before.sensitivity + by_candidates
    scale = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(after.mean / scale, (before.mean + gain @ residual) / scale, atol=1e-7)
    square = np.outer(scale, scale)
    np.testing.assert_allclose(after.covariance / square, expected / square, atol=1e-7)
    carried = (before.sensitivity - gain @ sensitivity) / scale[:, None]
    np.testing.assert_allclose(
        after.sensitivity / scale[:, None], carried, rtol=1e-6, atol=1e-7 * np.abs(carried).max()
    )
    weighted = np.linalg.solve(whole, np.column_stack([residual, sensitivity]))
    assert lesson.dof == len(residual)
    assert lesson.score is not None and lesson.information is not None
    assert lesson.nis == pytest.approx(residual @ weighted[:, 0])
    np.testing.assert_allclose(lesson.score, sensitivity.T @ weighted[:, 0], rtol=1e-5)
    np.testing.assert_allclose(lesson.information, sensitivity.T @ weighted[:, 1:], rtol=1e-5)


def dense_jacobian(state: State, innovation: Innovation) -> Array:
    count, width = innovation.residual.shape
    jacobian = np.zeros((count, width, len(state.mean)))
    for i, row in enumerate(innovation.rows):
        jacobian[i, :, POSE] = innovation.prediction.by_pose[i]
        start = state.robot_size + 3 * row
        jacobian[i, :, start : start + 3] = innovation.prediction.by_feature[i]
    jacobian[:, :, state.coefficient_columns] = derivatives(innovation.rows, width)[0]
    return jacobian.reshape(count * width, -1)


def block_diagonal(blocks: Array) -> Array:
    count, width, _ = blocks.shape
    matrix = np.zeros((count, width, count, width))
    matrix[np.arange(count), :, np.arange(count)] = blocks
    return matrix.reshape(count * width, count * width)


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
@pytest.mark.parametrize('rows', [np.arange(5), np.array([3, 0]), np.array([2])], ids=str)
class TestStackedUpdate:
    def test_it_is_the_textbook_s(self, form: Parametrisation, rows: IntArray) -> None:
        state, innovation = seen(form, rows)
        jacobian, noise = dense_jacobian(state, innovation), block_diagonal(innovation.noise)
        after, lesson = update(state, innovation)
        by_candidates = derivatives(rows, form.rows)[1].reshape(-1, C)
        residual = innovation.residual.ravel()
        assert_textbook(state, after, lesson, jacobian, residual, noise, by_candidates)
        assert_positive_definite(after.covariance)

    def test_what_is_not_asked_for_is_left_out(self, form: Parametrisation, rows: IntArray) -> None:
        """Without effects on the image, and without candidates."""
        state, _ = seen(form, rows)
        state = replace(state, sensitivity=state.sensitivity[:, :0])
        view = view_at(state.mean[POSE])
        prediction = form.predict(view, state.features[rows], state.landmarks.anchors[rows])
        measured, noise = form.measure(view, PIXELS[rows] + 0.5, NOISE_PX, FEATURES)
        none = innovate(state, rows, prediction, measured, noise)
        zeros = innovate(state, rows, prediction, measured, noise, np.zeros((len(rows), form.rows, K)))
        np.testing.assert_allclose(none.covariance, zeros.covariance, rtol=1e-12)
        after, lesson = update(state, none)
        np.testing.assert_allclose(after.mean, update(state, zeros)[0].mean, rtol=1e-9)
        assert lesson.information is None and lesson.score is None

    def test_distances_are_those_of_each_alone(self, form: Parametrisation, rows: IntArray) -> None:
        state, innovation = seen(form, rows)
        jacobian, noise = dense_jacobian(state, innovation), block_diagonal(innovation.noise)
        whole = jacobian @ state.covariance @ jacobian.T + noise
        width = form.rows
        for i, residual in enumerate(innovation.residual):
            own = whole[i * width : (i + 1) * width, i * width : (i + 1) * width]
            np.testing.assert_allclose(innovation.own_covariances()[i], own, rtol=1e-9)
            distance = mahalanobis(innovation.residual, own_precisions(innovation))[i]
            assert distance == pytest.approx(residual @ np.linalg.solve(own, residual))

    def test_choosing_is_seeing_fewer(self, form: Parametrisation, rows: IntArray) -> None:
        state, innovation = seen(form, rows)
        some = innovation[np.arange(len(rows) // 2, len(rows))]
        measured = some.residual + some.prediction.expected
        direct = innovate(
            state, some.rows, some.prediction, measured, some.noise, *derivatives(some.rows, form.rows)
        )
        assert len(some.rows) == (len(rows) + 1) // 2
        np.testing.assert_allclose(some.covariance, direct.covariance, rtol=1e-12)
        np.testing.assert_allclose(some.gain_numerator, direct.gain_numerator, rtol=1e-12)
        np.testing.assert_allclose(some.sensitivity, direct.sensitivity, rtol=1e-12)


def test_an_impossible_covariance_is_no_update() -> None:
    state, innovation = seen(INVERSE_DEPTH, np.arange(5))
    with pytest.raises(FilterDivergedError, match='not positive definite'):
        update(state, replace(innovation, covariance=-innovation.covariance))


def test_an_infinite_estimate_is_no_estimate() -> None:
    state, innovation = seen(INVERSE_DEPTH, np.arange(5))
    with pytest.raises(FilterDivergedError, match='no longer finite'):
        update(state, replace(innovation, residual=np.full((5, 2), np.nan)))


def still_block(rate_rad_s: float = 0.0) -> MotionBlock:
    block = eventful_block()
    rates = np.full((12, 3), 1e-4)
    rates[:, 2] += rate_rad_s
    return replace(block, rate_rad_s=rates, distance_m=np.zeros(12), wheels_at_rest=True)


def test_zero_rate_update_is_that_of_the_augmented_state() -> None:
    """The state before stands beside the state after, and their difference is measured."""
    before, block, std = some_state(), still_block(), math.radians(0.005)
    after, transition = step(before, block, GyroConfig(), WheelConfig())
    after = replace(after, sensitivity=2.0 * before.sensitivity)
    n = len(before.mean)
    matrix = np.vstack([dense_transition(before, block), np.eye(n)[EULER]])
    covariance = matrix @ before.covariance @ matrix.T
    covariance[:n, :n] = after.covariance  # with the noise of the prediction
    mean = np.concatenate([after.mean, before.euler_rad])
    sensitivity = np.concatenate([after.sensitivity, before.sensitivity[EULER]])

    jacobian = np.zeros((3, n + 3))
    jacobian[:, EULER], jacobian[:, n:] = np.eye(3), -np.eye(3)
    whole = jacobian @ covariance @ jacobian.T + std**2 * np.eye(3)
    gain = covariance @ jacobian.T @ np.linalg.inv(whole)
    updated, lesson = zero_rate_update(before, after, transition.matrix, std, gate=1e9)
    scale = np.sqrt(np.diagonal(after.covariance))
    np.testing.assert_allclose(updated.mean / scale, (mean - gain @ jacobian @ mean)[:n] / scale, atol=1e-7)
    np.testing.assert_allclose(
        updated.covariance / np.outer(scale, scale),
        (covariance - gain @ whole @ gain.T)[:n, :n] / np.outer(scale, scale),
        atol=1e-7,
    )
    np.testing.assert_allclose(
        updated.sensitivity, (sensitivity - gain @ jacobian @ sensitivity)[:n], rtol=1e-6, atol=1e-6
    )
    trial = jacobian @ sensitivity
    assert lesson.dof == 3 and lesson.nis > 0.0 and lesson.information is not None
    np.testing.assert_allclose(lesson.information, trial.T @ np.linalg.solve(whole, trial), rtol=1e-6)


def test_resting_teaches_the_bias() -> None:
    state = initial_state(MODEL, Config(), None)
    true_bias = np.radians([0.3, -0.2, 0.1])
    for i in range(60):
        block = replace(still_block(), rate_rad_s=np.tile(-true_bias, (12, 1)), time_s=np.full(12, 1e5))
        block = replace(block, start_ns=i, end_ns=i + round(block.dt_s.sum() * 1e9))
        after, transition = step(state, block, GyroConfig(), WheelConfig())
        state, _ = zero_rate_update(state, after, transition.matrix, math.radians(0.005), gate=21.0)
    std = np.sqrt(np.diagonal(state.covariance))[BIAS]
    np.testing.assert_array_less(std, math.radians(0.05))
    np.testing.assert_array_less(np.abs(state.bias_rad_s - true_bias), 0.1 * std)
    assert state.mean[9] == pytest.approx(0.0, abs=1e-3), 'rest says next to nothing of the scale'


def test_a_robot_that_turns_does_not_rest() -> None:
    before = some_state()
    after, transition = step(before, still_block(0.5), GyroConfig(), WheelConfig())
    gate = chi_square_quantile(0.9999, 3)
    state, lesson = zero_rate_update(before, after, transition.matrix, math.radians(0.005), gate)
    assert state is after and lesson.dof == 0


@pytest.mark.parametrize('turns', [-3, 0, 2])
def test_heading_update_is_the_textbook_s(turns: int) -> None:
    state, std, rng = some_state(), math.radians(0.5), np.random.default_rng(0)
    by_values, by_candidates = 0.01 * rng.normal(size=K) / SCALES, rng.normal(size=C)
    jacobian = np.zeros((1, len(state.mean)))
    jacobian[0, YAW], jacobian[0, state.coefficient_columns] = 1.0, by_values
    yaw_rad = float(state.mean[YAW]) + 0.02 + 2.0 * math.pi * turns
    after, lesson, residual, sigma = heading_update(state, yaw_rad, std, by_values, by_candidates)
    assert residual == pytest.approx(0.02)
    assert (residual / sigma) ** 2 == pytest.approx(lesson.nis)
    noise = np.array([[std**2]])
    assert_textbook(state, after, lesson, jacobian, np.array([residual]), noise, by_candidates[None])


# --- gate and noise -----------------------------------------------------------------------------


@pytest.mark.parametrize('probability', [0.5, 0.95, 0.99, 0.9999, 1.0 - 1e-6])
def test_chi_square_quantile(probability: float) -> None:
    assert chi_square_quantile(probability, 1) == pytest.approx(chi2.ppf(probability, 1))
    assert chi_square_quantile(probability, 2) == pytest.approx(chi2.ppf(probability, 2))
    exact = chi2.ppf(probability, 3)
    assert 0.99 * exact < chi_square_quantile(probability, 3) < 1.08 * exact


def test_the_gate_lets_good_ones_through() -> None:
    distances = chi2.rvs(2, size=(5000, 15), random_state=0)
    refused = np.mean([~inliers(row, 2, 0.01) for row in distances])
    assert 0.002 < refused < 0.012


@pytest.mark.parametrize('count', [1, 2, 3, 4, 5, 6, 15])
def test_outliers_stay_out_while_they_are_no_more_than_half(count: int) -> None:
    good = np.linspace(0.2, 3.0, count - count // 2)
    bad = np.full(count // 2, 1000.0)
    assert inliers(np.concatenate([bad, good]), 2, 1e-4).tolist() == [False] * len(bad) + [True] * len(good)


def test_the_gate_widens_when_the_whole_image_speaks() -> None:
    """What the model lacks shifts all features at once: that is no reason not to look."""
    shifted = chi2.rvs(2, size=15, random_state=0) + 60.0
    assert inliers(shifted, 2, 1e-4).all()
    assert inliers(np.append(shifted, 1e5), 2, 1e-4).tolist() == [True] * 15 + [False]


@pytest.mark.parametrize('outliers', [0.0, 0.05])
@pytest.mark.parametrize('true_px', [0.1, 0.4, 1.5])
def test_noise_is_followed_to_the_truth(true_px: float, outliers: float) -> None:
    follower, rng = AdaptiveNoise(0.4, 0.02, 10.0), np.random.default_rng(0)
    settled = []
    for frame in range(3000):
        distances = (true_px / follower.std) ** 2 * rng.chisquare(2, 15)
        distances[rng.random(15) < outliers] = 1e4
        follower.follow(distances, 2)
        if frame > 600:
            settled.append(follower.std)
    # 5 % of outliers push the median of the others up to their 0.526 quantile
    median = chi_square_quantile(0.5 / (1.0 - outliers), 2) / chi_square_quantile(0.5, 2)
    assert np.mean(settled) == pytest.approx(true_px * math.sqrt(median), rel=0.02)
    assert np.std(settled) < 0.05 * true_px


def test_noise_is_followed_within_bounds() -> None:
    follower = AdaptiveNoise(0.4, 0.02, 10.0)
    follower.follow(np.empty(0), 2)
    assert follower.std == 0.4
    for _ in range(3000):
        follower.follow(np.full(15, 1e6), 2)
    assert follower.std == 10.0 and follower.is_at_the_top
    for _ in range(3000):
        follower.follow(np.zeros(15), 2)
    assert follower.std == 0.02 and not follower.is_at_the_top


# --- map ----------------------------------------------------------------------------------------


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
def test_new_features_join_with_all_correlations(form: Parametrisation) -> None:
    state = some_state(form)
    new = form.initialise(view_at(state.mean[POSE]), PIXELS[:2] + 5.0, NOISE_PX, FEATURES)
    by_values, by_candidates = derivatives(np.arange(2), 3)
    after = augment(state, np.array([20, 21]), new, by_values, by_candidates)
    n = len(state.mean)
    jacobian = np.zeros((n + 6, n))
    jacobian[:n] = np.eye(n)
    jacobian[n:, POSE] = new.by_pose.reshape(6, 6)
    jacobian[n:, state.coefficient_columns] = by_values.reshape(6, K)
    sensitivity = jacobian @ state.sensitivity
    sensitivity[n:] += by_candidates.reshape(6, C)
    np.testing.assert_allclose(after.sensitivity, sensitivity, rtol=1e-9, atol=1e-9)
    expected = jacobian @ state.covariance @ jacobian.T
    expected[n:, n:] += block_diagonal(new.noise)
    np.testing.assert_allclose(after.covariance, expected, rtol=1e-12, atol=1e-18)
    np.testing.assert_array_equal(after.mean[:n], state.mean)
    np.testing.assert_array_equal(after.features[5:], new.parameters)
    assert after.landmarks.ids.tolist() == [3, 1, 4, 15, 9, 20, 21]
    assert after.landmarks.last_seen_ns.tolist()[5:] == [state.t_ns] * 2
    assert_positive_definite(after.covariance)


def test_forgetting_leaves_the_rest_alone() -> None:
    state = some_state()
    after = keep(state, np.array([True, False, True, True, False]))
    kept = [*range(state.robot_size), *state.feature_columns(np.array([0, 2, 3])).ravel()]
    np.testing.assert_array_equal(after.mean, state.mean[kept])
    np.testing.assert_array_equal(after.covariance, state.covariance[np.ix_(kept, kept)])
    np.testing.assert_array_equal(after.sensitivity, state.sensitivity[kept])
    assert after.landmarks.ids.tolist() == [3, 4, 15]
    np.testing.assert_array_equal(after.landmarks.anchors.p_wc, state.landmarks.anchors.p_wc[[0, 2, 3]])
    assert keep(state, np.ones(5, bool)) is state

    bare = forget_all(state)
    np.testing.assert_array_equal(bare.covariance, state.covariance[: state.robot_size, : state.robot_size])
    assert bare.features.shape == (0, 3) and len(bare.landmarks.ids) == 0


def test_a_feature_that_joins_and_leaves_changes_nothing() -> None:
    state = some_state()
    new = INVERSE_DEPTH.initialise(view_at(state.mean[POSE]), PIXELS[:1], NOISE_PX, FEATURES)
    after = keep(augment(state, np.array([30]), new, None, None), np.array([True] * 5 + [False]))
    np.testing.assert_array_equal(after.mean, state.mean)
    np.testing.assert_array_equal(after.covariance, state.covariance)


def with_sightings(last_seen_ns: list[int], t_ns: int) -> State:
    state = some_state(t_ns=t_ns)
    return replace(state, landmarks=replace(state.landmarks, last_seen_ns=np.array(last_seen_ns)))


def test_room_is_made_by_those_unseen_for_longest() -> None:
    state = with_sightings([50, 20, 40, 10, 30], t_ns=60)
    assert evict_oldest(state, wanted=3, map_size=8) is state
    assert evict_oldest(state, wanted=3, map_size=6).landmarks.ids.tolist() == [3, 4, 9]
    assert evict_oldest(state, wanted=9, map_size=6).landmarks.ids.tolist() == []


def test_outliers_in_a_row_are_forgotten() -> None:
    state = some_state()
    for _ in range(2):
        state = count_matches(state, np.array([0, 2]), np.array([1, 4]), drop_after=3)
    assert state.landmarks.rejections.tolist() == [0, 2, 0, 0, 2]
    state = count_matches(state, np.array([4]), np.array([1]), drop_after=3)
    assert state.landmarks.ids.tolist() == [3, 4, 15, 9]
    assert state.landmarks.rejections.tolist() == [0, 0, 0, 0]


def test_sightings_are_dated() -> None:
    state = with_sightings([0, 0, 0, 0, 0], t_ns=60)
    state = count_matches(state, np.array([0, 2]), np.array([1]), drop_after=3)
    assert state.landmarks.last_seen_ns.tolist() == [60, 0, 60, 0, 0]


# --- start --------------------------------------------------------------------------------------


def test_a_run_starts_from_its_priors() -> None:
    state = initial_state(MODEL, Config(), None)
    std = np.sqrt(np.diagonal(state.covariance))
    np.testing.assert_array_equal(std[POSE], 0.0)
    np.testing.assert_allclose(std[BIAS], math.radians(1.0))
    np.testing.assert_allclose(std[9:], [item.prior_std for item in MODEL.coefficients])
    np.testing.assert_array_equal(state.mean[9:], [item.prior_mean for item in MODEL.coefficients])


def test_a_run_starts_from_what_an_earlier_one_knew() -> None:
    """By name: what this model does not have is left out, and the bias keeps the doubt of its prior."""
    names = ('bias', 'scale_temperature', 'scale_cubic', 'scale_factor')
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(4, 4)) * [[1e-3], [1.0], [1e-4], [1e-3]]
    known = mixing @ mixing.T
    state = initial_state(MODEL, Config(), Start(names, np.array([0.01, 9.0, 0.002, -0.07]), known))
    places, taken = [YAW_BIAS, 10, 9], [0, 2, 3]
    np.testing.assert_array_equal(state.mean[places], [0.01, 0.002, -0.07])
    expected = known[np.ix_(taken, taken)]
    expected[0, 0] += math.radians(1.0) ** 2
    np.testing.assert_allclose(state.covariance[np.ix_(places, places)], expected)
    fresh = initial_state(MODEL, Config(), None)
    np.testing.assert_array_equal(state.mean[11:], fresh.mean[11:])
    np.testing.assert_array_equal(state.covariance[11:], fresh.covariance[11:])


def test_nobody_saw_the_robot_move() -> None:
    state = forget_all(some_state())
    after = inflate_after_gap(state, 99)
    grown = after.covariance - state.covariance
    assert after.t_ns == 99
    np.testing.assert_array_equal(after.mean, state.mean)
    np.testing.assert_array_equal(np.flatnonzero(np.diagonal(grown)), [0, 1, 2, YAW])
    assert np.count_nonzero(grown) == 4
