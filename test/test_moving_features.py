"""Features that are removed from the map again and again: they move, unless most of them do."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import IntArray
from gyrocal_ros.ekf.features.moving_features import MAX_DROPS, MovingFeatures

IDS = np.arange(10)
NONE = np.empty(0, np.int64)


@pytest.fixture
def moving() -> MovingFeatures:
    """Return what is known of ten features, 3 and 7 of which were removed too often."""
    features = MovingFeatures()
    for _ in range(MAX_DROPS):
        features.update(IDS, np.array([3, 7]))
    return features


def fixed(features: MovingFeatures) -> IntArray:
    """Return which of the ten may be in the map."""
    return np.flatnonzero(features.are_fixed(IDS))


def test_a_feature_gets_a_second_chance() -> None:
    features = MovingFeatures()
    for _ in range(MAX_DROPS - 1):
        features.update(IDS, np.array([3]))
    assert len(fixed(features)) == 10


def test_features_removed_again_and_again_stay_out(moving: MovingFeatures) -> None:
    moving.update(IDS, NONE)
    np.testing.assert_array_equal(fixed(moving), np.setdiff1d(IDS, [3, 7]))


def test_a_feature_out_of_view_is_forgotten(moving: MovingFeatures) -> None:
    moving.update(np.delete(IDS, 3), NONE)
    np.testing.assert_array_equal(fixed(moving), np.delete(IDS, 7))


def test_where_most_features_seem_to_move_none_of_them_does(moving: MovingFeatures) -> None:
    for _ in range(MAX_DROPS):
        moving.update(IDS, np.array([0, 1, 2, 4]))
    assert len(fixed(moving)) == 10
