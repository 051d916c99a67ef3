"""Which features join the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from filter_states import some_state

from gyrocal_ros.ekf.features.admission import Admission
from gyrocal_ros.ekf.features.moving_features import MovingFeatures
from gyrocal_ros.ekf.state.layout import State

FIXED = MovingFeatures()


def seen_now(count: int) -> State:
    """Return a state whose first features were just seen."""
    state = some_state(t_ns=60)
    last_seen_ns = np.where(np.arange(len(state.landmarks.ids)) < count, 60, 0)
    return replace(state, landmarks=replace(state.landmarks, last_seen_ns=last_seen_ns))


def test_new_features_join_a_map_with_room_at_once() -> None:
    state = seen_now(0)
    known = len(state.landmarks.ids)
    ids = np.array([state.landmarks.ids[0], 101, 102, 103])
    assert Admission().choose(state, ids, FIXED, map_size=known + 2) == [1, 2]


def test_a_full_map_is_not_driven_out_by_corners_that_no_second_image_shows() -> None:
    state, admission = seen_now(0), Admission()
    known = len(state.landmarks.ids)
    for image in range(5):
        dark = np.arange(100 * image + 100, 100 * image + 120)
        assert admission.choose(state, dark, FIXED, known) == []
    tracked = np.array([515, 700, 519])
    assert admission.choose(state, tracked, FIXED, known) == [0, 2], 'these were in the last image'


def test_tracked_features_go_before_new_ones_where_there_is_little_room() -> None:
    state, admission = seen_now(0), Admission()
    known = len(state.landmarks.ids)
    admission.choose(state, np.array([101]), FIXED, known)
    assert admission.choose(state, np.array([100, 101, 102]), FIXED, known + 2) == [0, 1]


def test_no_feature_that_was_just_seen_gives_its_place_up() -> None:
    admission, state = Admission(), seen_now(4)
    known, ids = len(state.landmarks.ids), np.array([101, 102, 103])
    admission.choose(state, ids, FIXED, known)
    assert admission.choose(state, ids, FIXED, known) == list(range(known - 4))


def test_features_that_move_do_not_join() -> None:
    moving = MovingFeatures()
    moving.add(np.array([102]))
    state = seen_now(0)
    assert Admission().choose(state, np.array([101, 102, 103]), moving, map_size=30) == [0, 2]
