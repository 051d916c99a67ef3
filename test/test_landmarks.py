"""The map of features: augmentation with all correlations, and removal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import FEATURES, NOISE_PX, PIXELS, assert_positive_definite, view_at
from filter_states import DIRECTIONS, INVERSE_DEPTH, C, K, block_diagonal, derivatives, some_state

from gyrocal_ros.ekf.features.landmarks import (
    augment,
    count_matches,
    evict_oldest,
    forget_all,
    keep,
    mark_seen,
)
from gyrocal_ros.ekf.state.layout import POSE, FeatureNoise, State
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import Parametrisation


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
def test_new_features_join_with_all_correlations(form: Parametrisation) -> None:
    state = some_state(form)
    new = form.initialise(view_at(state.mean[POSE]), PIXELS[:2] + 5.0, NOISE_PX, FEATURES)
    by_values, by_candidates = derivatives(np.arange(2), 3)
    after = augment(state, np.array([20, 21]), PIXELS[:2], DIRECTIONS[:2], new, by_values, by_candidates)
    n, features = len(state.mean), slice(state.anchors_start, state.anchors_start + 6)
    behind = slice(features.stop, features.stop + n - state.anchors_start)
    jacobian = np.zeros((len(after.mean), n))
    jacobian[: features.start, : features.start] = np.eye(features.start)
    jacobian[features, POSE] = new.by_pose.reshape(6, 6)
    jacobian[features, state.coefficient_columns] = by_values.reshape(6, K)
    jacobian[behind, features.start :] = np.eye(n - features.start)
    if new.anchor_by_pose is not None:
        jacobian[behind.stop :, POSE] = new.anchor_by_pose
        np.testing.assert_array_equal(after.mean[behind.stop :], new.anchors.p_wc[0])
    sensitivity = jacobian @ state.sensitivity
    sensitivity[features] += by_candidates.reshape(6, C)
    np.testing.assert_allclose(after.sensitivity, sensitivity, rtol=1e-9, atol=1e-9)
    expected = jacobian @ state.covariance @ jacobian.T
    expected[features, features] += block_diagonal(new.noise)
    np.testing.assert_allclose(after.covariance, expected, rtol=1e-12, atol=1e-18)
    np.testing.assert_array_equal(
        np.concatenate([after.mean[: features.start], after.mean[behind]]), state.mean
    )
    np.testing.assert_array_equal(after.features[5:], new.parameters)
    assert after.landmarks.ids.tolist() == [3, 1, 4, 15, 9, 20, 21]
    assert after.landmarks.last_seen_ns.tolist()[5:] == [state.t_ns] * 2
    # a new anchor is where the camera is
    assert_positive_definite(after.covariance[: behind.stop, : behind.stop])


@pytest.mark.parametrize('form', PARAMETRISATIONS.values(), ids=PARAMETRISATIONS)
def test_an_error_of_the_stamp_moves_new_features_together(form: Parametrisation) -> None:
    state = some_state(form)
    new = form.initialise(view_at(state.mean[POSE]), PIXELS[:2], NOISE_PX, FEATURES)
    arguments = state, np.array([20, 21]), PIXELS[:2], DIRECTIONS[:2], new, None, None
    by_stamp = 0.01 * np.array([0.3, -0.1, 0.0, 0.02, 0.01, 1.2])
    added = augment(*arguments, by_stamp).covariance - augment(*arguments).covariance
    moved = np.zeros(len(added))
    moved[state.anchors_start : state.anchors_start + 6] = new.by_pose.reshape(6, 6) @ by_stamp
    if new.anchor_by_pose is not None:
        moved[-3:] = new.anchor_by_pose @ by_stamp
    np.testing.assert_allclose(added, np.outer(moved, moved), atol=1e-12)


def test_removal_leaves_the_rest_unchanged() -> None:
    state = some_state()
    after = keep(state, np.array([True, False, True, True, False]))
    kept = [*range(state.robot_size), *state.feature_columns(np.array([0, 2, 3])).ravel()]
    kept += range(state.anchors_start, len(state.mean))
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
    after = keep(
        augment(state, np.array([30]), PIXELS[:1], DIRECTIONS[:1], new, None, None),
        np.array([True] * 5 + [False]),
    )
    np.testing.assert_array_equal(after.mean, state.mean)
    np.testing.assert_array_equal(after.covariance, state.covariance)


def last_seen_at(last_seen_ns: list[int], t_ns: int) -> State:
    state = some_state(t_ns=t_ns)
    return replace(state, landmarks=replace(state.landmarks, last_seen_ns=np.array(last_seen_ns)))


def test_features_unseen_for_longest_are_evicted() -> None:
    state = last_seen_at([50, 20, 40, 10, 30], t_ns=60)
    assert evict_oldest(state, wanted=3, map_size=8) is state
    assert evict_oldest(state, wanted=3, map_size=6).landmarks.ids.tolist() == [3, 4, 9]
    assert evict_oldest(state, wanted=9, map_size=6).landmarks.ids.tolist() == []


def test_features_never_found_again_are_evicted_first() -> None:
    state = last_seen_at([50, 20, 60, 10, 30], t_ns=60)
    ids, found_again = state.landmarks.ids, np.array([0.0, 5.0, 0.0, 2.0, 0.0])
    noise = FeatureNoise(found_again, found_again)
    state = replace(state, landmarks=replace(state.landmarks, noise=noise))
    kept = evict_oldest(state, wanted=2, map_size=5).landmarks.ids
    assert kept.tolist() == ids[[1, 2, 3]].tolist(), 'the one just seen stays, too'


BEFORE = np.zeros((5, 2))


def matched(state: State, rows: list[int], accepted: list[bool]) -> State:
    before = BEFORE[: len(rows)]
    return count_matches(state, np.array(rows), np.array(accepted), before - 3.0, before + 7.0, drop_after=3)


def test_features_with_consecutive_outliers_are_removed() -> None:
    state = some_state()
    for _ in range(2):
        state = matched(state, [0, 1, 2, 4], [True, False, True, False])
    assert state.landmarks.rejections.tolist() == [0, 2, 0, 0, 2]
    state = matched(state, [4, 1], [True, False])
    assert state.landmarks.ids.tolist() == [3, 4, 15, 9]
    assert state.landmarks.rejections.tolist() == [0, 0, 0, 0]


def test_matches_set_the_time_last_seen() -> None:
    state = matched(last_seen_at([0, 0, 0, 0, 0], t_ns=60), [0, 1, 2], [True, False, True])
    assert state.landmarks.last_seen_ns.tolist() == [60, 0, 60, 0, 0]
    assert mark_seen(state, np.array([4])).landmarks.last_seen_ns.tolist() == [60, 0, 60, 0, 60]


def test_features_that_are_judged_store_where_they_were_seen_and_expected() -> None:
    after = matched(some_state(), [3, 1], [True, False])
    kept, judged = [0, 2, 4], [1, 3]
    np.testing.assert_array_equal(after.landmarks.last_pixels[judged], BEFORE[:2] - 3.0)
    np.testing.assert_array_equal(after.landmarks.last_directions[judged], BEFORE[:2] + 7.0)
    np.testing.assert_array_equal(after.landmarks.last_pixels[kept], PIXELS[kept])
    np.testing.assert_array_equal(after.landmarks.last_directions[kept], DIRECTIONS[kept])
