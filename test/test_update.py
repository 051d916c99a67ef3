"""Measurement updates against the textbook formulas on whole, dense matrices."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import FEATURES, NOISE_PX, PIXELS, assert_positive_definite, eventful_block, view_at
from filter_states import (
    INVERSE_DEPTH,
    MODEL,
    SCALES,
    C,
    K,
    block_diagonal,
    dense_transition,
    derivatives,
    some_state,
    step,
)

from gyrocal_ros.config.sections import Config, GyroConfig, WheelConfig
from gyrocal_ros.data import Array, IntArray, MotionBlock
from gyrocal_ros.ekf.equations.update import (
    Innovation,
    UpdateStats,
    heading_innovation,
    heading_update,
    innovate,
    own_precisions,
    update,
    zero_rate_update,
)
from gyrocal_ros.ekf.features.judged import mahalanobis
from gyrocal_ros.ekf.state.layout import BIAS, EULER, POSE, YAW, State
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import Parametrisation
from gyrocal_ros.statistics import chi_square_quantile


def seen(form: Parametrisation, rows: IntArray, seed: int = 1) -> tuple[State, Innovation]:
    """Return a state and the innovation of some of its features."""
    state, rng = some_state(form), np.random.default_rng(seed)
    view = view_at(state.mean[POSE])
    prediction = form.predict(view, state.features[rows], state.anchors_of(rows))
    measured, noise = form.measure(view, PIXELS[rows] + rng.normal(size=(len(rows), 2)), NOISE_PX, FEATURES)
    by_values, by_candidates = derivatives(rows, form.rows)
    return state, innovate(state, rows, prediction, measured, noise, by_values, by_candidates)


def assert_textbook(
    before: State,
    after: State,
    stats: UpdateStats,
    jacobian: Array,
    residual: Array,
    noise: Array,
    by_candidates: Array,
) -> None:
    """Check the Kalman update, covariance in Joseph's form, and the sensitivities to the candidates."""
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
    assert stats.dof == len(residual)
    assert stats.score is not None and stats.information is not None
    assert stats.nis == pytest.approx(residual @ weighted[:, 0])
    np.testing.assert_allclose(stats.score, sensitivity.T @ weighted[:, 0], rtol=1e-5)
    np.testing.assert_allclose(stats.information, sensitivity.T @ weighted[:, 1:], rtol=1e-5)


def dense_jacobian(state: State, innovation: Innovation) -> Array:
    count, width = innovation.residual.shape
    jacobian = np.zeros((count, width, len(state.mean)))
    for i, row in enumerate(innovation.rows):
        jacobian[i, :, POSE] = innovation.prediction.by_pose[i]
        start = state.robot_size + 3 * row
        jacobian[i, :, start : start + 3] = innovation.prediction.by_feature[i]
        if (anchor := int(state.anchor_columns(np.array([row]))[0])) >= 0:
            jacobian[i, :, anchor : anchor + 3] = -innovation.prediction.by_pose[i, :, :3]
    jacobian[:, :, state.coefficient_columns] = derivatives(innovation.rows, width)[0]
    return jacobian.reshape(count * width, -1)


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
@pytest.mark.parametrize('rows', [np.arange(5), np.array([3, 0]), np.array([2])], ids=str)
class TestStackedUpdate:
    def test_agrees_with_the_textbook(self, form: Parametrisation, rows: IntArray) -> None:
        state, innovation = seen(form, rows)
        jacobian, noise = dense_jacobian(state, innovation), block_diagonal(innovation.noise)
        after, stats = update(state, innovation)
        by_candidates = derivatives(rows, form.rows)[1].reshape(-1, C)
        residual = innovation.residual.ravel()
        assert_textbook(state, after, stats, jacobian, residual, noise, by_candidates)
        assert_positive_definite(after.covariance)

    def test_absent_derivatives_count_as_zero(self, form: Parametrisation, rows: IntArray) -> None:
        """There are no effects on the image, and no candidates."""
        state, _ = seen(form, rows)
        state = replace(state, sensitivity=state.sensitivity[:, :0])
        view = view_at(state.mean[POSE])
        prediction = form.predict(view, state.features[rows], state.anchors_of(rows))
        measured, noise = form.measure(view, PIXELS[rows] + 0.5, NOISE_PX, FEATURES)
        none = innovate(state, rows, prediction, measured, noise)
        zeros = innovate(state, rows, prediction, measured, noise, np.zeros((len(rows), form.rows, K)))
        np.testing.assert_allclose(none.covariance, zeros.covariance, rtol=1e-12)
        after, stats = update(state, none)
        np.testing.assert_allclose(after.mean, update(state, zeros)[0].mean, rtol=1e-9)
        assert stats.information is None and stats.score is None

    def test_distances_are_by_the_covariance_of_each_feature(
        self, form: Parametrisation, rows: IntArray
    ) -> None:
        state, innovation = seen(form, rows)
        jacobian, noise = dense_jacobian(state, innovation), block_diagonal(innovation.noise)
        whole = jacobian @ state.covariance @ jacobian.T + noise
        width = form.rows
        for i, residual in enumerate(innovation.residual):
            own = whole[i * width : (i + 1) * width, i * width : (i + 1) * width]
            np.testing.assert_allclose(innovation.own_covariances()[i], own, rtol=1e-9)
            distance = mahalanobis(innovation.residual, own_precisions(innovation))[i]
            assert distance == pytest.approx(residual @ np.linalg.solve(own, residual))

    def test_a_selection_equals_the_innovation_of_fewer_features(
        self, form: Parametrisation, rows: IntArray
    ) -> None:
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


def test_a_covariance_that_is_not_positive_definite_raises() -> None:
    state, innovation = seen(INVERSE_DEPTH, np.arange(5))
    with pytest.raises(FilterDivergedError, match='no longer positive definite'):
        update(state, replace(innovation, covariance=-innovation.covariance))


def test_an_infinite_estimate_raises() -> None:
    state, innovation = seen(INVERSE_DEPTH, np.arange(5))
    with pytest.raises(FilterDivergedError, match='no longer finite'):
        update(state, replace(innovation, stacked=np.full_like(innovation.stacked, np.nan)))


def still_block(rate_rad_s: float = 0.0) -> MotionBlock:
    block = eventful_block()
    rates = np.full((12, 3), 1e-4)
    rates[:, 2] += rate_rad_s
    return replace(block, rate_rad_s=rates, distance_m=np.zeros(12), wheels_at_rest=True)


def test_zero_rate_update_agrees_with_the_augmented_state() -> None:
    """The augmented state holds the Euler angles before and after; their difference is measured."""
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
    updated, stats = zero_rate_update(before, after, transition.matrix, std, gate=1e9)
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
    innovation_sensitivity = jacobian @ sensitivity
    assert stats.dof == 3 and stats.nis > 0.0 and stats.information is not None
    expected = innovation_sensitivity.T @ np.linalg.solve(whole, innovation_sensitivity)
    np.testing.assert_allclose(stats.information, expected, rtol=1e-6)


def test_rest_estimates_the_bias() -> None:
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
    assert state.mean[9] == pytest.approx(0.0, abs=1e-3), 'rest hardly depends on the scale factor'


def test_no_zero_rate_update_while_turning() -> None:
    before = some_state()
    after, transition = step(before, still_block(0.5), GyroConfig(), WheelConfig())
    gate = chi_square_quantile(0.9999, 3)
    state, stats = zero_rate_update(before, after, transition.matrix, math.radians(0.005), gate)
    assert state is after and stats.dof == 0


@pytest.mark.parametrize('turns', [-3, 0, 2])
def test_heading_update_agrees_with_the_textbook(turns: int) -> None:
    state, std, rng = some_state(), math.radians(0.5), np.random.default_rng(0)
    by_values, by_candidates = 0.01 * rng.normal(size=K) / SCALES, rng.normal(size=C)
    jacobian = np.zeros((1, len(state.mean)))
    jacobian[0, YAW], jacobian[0, state.coefficient_columns] = 1.0, by_values
    yaw_rad = float(state.mean[YAW]) + 0.02 + 2.0 * math.pi * turns
    after, stats, residual = heading_update(state, yaw_rad, std, by_values, by_candidates)
    assert residual == pytest.approx(0.02)
    assert heading_innovation(state, yaw_rad, by_values)[0] == residual
    noise = np.array([[std**2]])
    assert_textbook(state, after, stats, jacobian, np.array([residual]), noise, by_candidates[None])
