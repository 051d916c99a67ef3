"""Features judged by each other: leave-one-out distances and Huber's weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import NOISE_PX, PIXELS, view_at
from filter_states import INVERSE_DEPTH, some_state

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.equations.update import Innovation, innovate
from gyrocal_ros.ekf.features.judged import each_alone, leave_one_out
from gyrocal_ros.ekf.features.robust import HUBER_BOUND, MIN_FEATURES, Consensus, Slip, consensus
from gyrocal_ros.ekf.state.layout import POSE, State

ONES = np.ones(5)
INTERVAL_S = 0.1


def known_map(pose_part: float = 1.0) -> State:
    """Return a state with an uncertain pose, by a factor, and landmarks known to about the pixel noise."""
    state = some_state()
    std = np.full(len(state.mean), 1e-4)
    std[POSE] = pose_part * np.array([0.02, 0.02, 0.001, 0.002, 0.002, 0.02])
    return replace(state, covariance=0.01 * np.outer(std, std) + 0.99 * np.diag(std**2))


def innovation_of(residual: Array, pose_part: float = 1.0) -> Innovation:
    """Return the innovation of the five features of that state, or of more observations of them."""
    state, rows = known_map(pose_part), np.arange(len(residual)) % 5
    features, anchors = state.features[rows], state.anchors_of(rows)
    prediction = INVERSE_DEPTH.predict(view_at(state.mean[POSE]), features, anchors)
    noise = np.broadcast_to(NOISE_PX**2 * np.eye(2), (len(rows), 2, 2))
    return innovate(state, rows, prediction, prediction.expected + residual, noise)


def drawn(seed: int) -> Innovation:
    """Return an innovation drawn from its own covariance."""
    expected = innovation_of(np.zeros_like(PIXELS))
    factor = np.linalg.cholesky(expected.covariance.reshape(10, 10))
    residual = (factor @ np.random.default_rng(seed).normal(size=10)).reshape(5, 2)
    return replace(expected, residual=residual)


@pytest.mark.parametrize('feature', range(5))
def test_the_difference_is_from_the_conditional_mean(feature: int) -> None:
    innovation = drawn(3)
    covariance, residual = innovation.covariance.reshape(10, 10), innovation.residual.ravel()
    own = np.array([2 * feature, 2 * feature + 1])
    others = np.setdiff1d(np.arange(10), own)
    gain = np.linalg.solve(covariance[np.ix_(others, others)], covariance[np.ix_(others, own)]).T
    difference = residual[own] - gain @ residual[others]
    variance = covariance[np.ix_(own, own)] - gain @ covariance[np.ix_(others, own)]
    expected = difference @ np.linalg.solve(variance, difference)
    judged = leave_one_out(innovation, ONES)
    assert judged.distances[feature] == pytest.approx(expected)
    assert judged.noise_share[feature] == pytest.approx(2 * NOISE_PX**2 / np.trace(variance))


def test_the_distances_are_chi_square_distributed() -> None:
    distances = np.concatenate([leave_one_out(drawn(seed), ONES).distances for seed in range(400)])
    assert np.mean(distances) == pytest.approx(2.0, rel=0.08)
    assert np.mean(distances > 5.991) == pytest.approx(0.05, abs=0.015)


def test_a_wrong_match_shows_more_clearly_than_by_the_map_alone() -> None:
    residual = np.zeros((5, 2))
    residual[2] = [8.0 * NOISE_PX, 0.0]
    innovation = innovation_of(residual)
    alone, judged = each_alone(innovation), leave_one_out(innovation, ONES)
    assert judged.distances[2] > 3.0 * alone.distances[2]
    assert np.argmax(judged_by(innovation).judged.distances) == 2


def test_the_noise_of_a_contradicted_feature_grows() -> None:
    residual = np.zeros((5, 2))
    residual[2] = [10.0 * NOISE_PX, -10.0 * NOISE_PX]
    innovation = innovation_of(residual)
    result = judged_by(innovation)
    change = (result.innovation.covariance - innovation.covariance) / NOISE_PX**2
    each = np.arange(5)
    inflation = change[each, :, each, :]
    expected = np.maximum(0.0, np.sqrt(result.judged.distances) / HUBER_BOUND - 1.0)
    np.testing.assert_allclose(inflation, expected[:, None, None] * np.eye(2), rtol=0.1, atol=1e-9)
    assert np.argmax(expected) == 2 and not expected[[0, 3, 4]].any()
    change[each, :, each, :] = 0.0
    assert not change.any()


def test_a_pose_that_the_features_contradict_does_not_judge_them() -> None:
    still = np.zeros((10, 2))
    turned = innovation_of(still, 0.01).prediction.by_pose[:, :, 5] * 0.02  # a hundred standard deviations
    assert leave_one_out(innovation_of(turned, 0.01), np.ones(len(turned))).distances.max() > 20.0
    turned[1] += [0.0, 30.0 * NOISE_PX]
    good = judged_by(innovation_of(turned, 0.01)).good
    assert not good[1] and np.delete(good, [1, 6]).all(), '6 is of the same landmark'


def test_a_bent_map_widens_the_gate_where_the_pose_explains_the_rest() -> None:
    bent = 6.0 * NOISE_PX * np.random.default_rng(1).normal(size=(10, 2))
    turned = innovation_of(np.zeros((10, 2)), 0.01).prediction.by_pose[:, :, 5] * 0.3
    assert judged_by(innovation_of(turned + bent, 0.01)).good.sum() >= 8
    assert judged_by(innovation_of(bent, 0.01)).rejects_image, 'no pose explains it'


def partly_moved(fixed: int, axis: int, count: int = 15) -> tuple[Innovation, np.ndarray]:
    """Return an image whose first features are fixed and the others move by 0.1 m or rad, and which do."""
    moved = 0.1 * innovation_of(np.zeros((count, 2)), 0.01).prediction.by_pose[:, :, axis]
    moved[:fixed] = 0.0
    return innovation_of(moved, 0.01), np.linalg.norm(moved, axis=1) > 10.0 * NOISE_PX


@pytest.mark.parametrize('axis', [0, 5], ids=['shifted', 'turned'])
@pytest.mark.parametrize('fixed', [6, 8, 11])
def test_half_of_the_view_that_moves_is_rejected(fixed: int, axis: int) -> None:
    innovation, moves = partly_moved(fixed, axis)
    pass
    found = judged_by(innovation)
    np.testing.assert_array_equal(found.good, ~moves)
    assert found.slip_std is None and not found.contradicts_turn


@pytest.mark.parametrize('largest_rad', [0.05, 0.2])
def test_a_turn_that_no_gyro_misses_is_followed_with_a_free_pose(largest_rad: float) -> None:
    """All features agree upon a turn of 0.1 rad that the gyro has not seen."""
    state = known_map(0.01)
    turned = state.mean[POSE] + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    rows = np.arange(5)
    seen = INVERSE_DEPTH.predict(view_at(turned), state.features, state.anchors_of(rows)).expected
    expected = INVERSE_DEPTH.predict(view_at(state.mean[POSE]), state.features, state.anchors_of(rows))
    innovation = innovation_of(seen - expected.expected, 0.01)
    found = consensus(innovation, 1e-4, INTERVAL_S, Slip.EXCLUDED, largest_rad)
    assert found.contradicts_pose and found.good.all()
    if largest_rad > 0.1:
        assert found.freed is None
    else:
        assert found.freed is not None
        assert found.freed.turn_rad == pytest.approx(0.1, rel=0.1)


def test_witnesses_that_are_outvoted_leave_nothing_to_use() -> None:
    found = judged_by(partly_moved(4, 5, 25)[0])
    assert found.rejects_image and not found.contradicts_turn


def test_few_features_do_not_contradict_the_pose() -> None:
    few = MIN_FEATURES - 1
    turned = innovation_of(np.zeros((few, 2)), 0.01).prediction.by_pose[:, :, 5] * 0.02
    assert not judged_by(innovation_of(turned, 0.01)).good.all()
    still = np.zeros((few, 2))
    still[1] += 30.0 * NOISE_PX
    assert judged_by(innovation_of(still, 0.01)).good.tolist() == [True, False, True, True]


def judged_by(innovation: Innovation, interval_s: float = INTERVAL_S) -> Consensus:
    """Return the result at the usual rejection probability."""
    return consensus(innovation, 1e-4, interval_s)


def test_an_image_without_outliers_is_left_alone() -> None:
    innovation = innovation_of(np.zeros((5, 2)))
    np.testing.assert_array_equal(judged_by(innovation).innovation.covariance, innovation.covariance)


def test_the_gate_rejects_what_the_others_contradict() -> None:
    residual = np.zeros((5, 2))
    residual[2] = [10.0 * NOISE_PX, -10.0 * NOISE_PX]
    assert judged_by(innovation_of(residual)).good.tolist() == [True, False, False, True, True]
    assert judged_by(innovation_of(np.zeros((5, 2)))).good.all()


def test_features_that_contradict_each_other_are_not_used() -> None:
    scattered = 300.0 * NOISE_PX * np.random.default_rng(0).normal(size=(10, 2))
    assert not judged_by(innovation_of(scattered)).good.any()
