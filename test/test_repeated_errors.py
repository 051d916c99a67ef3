"""Errors that repeat while a feature does not move in the image."""

from __future__ import annotations

import numpy as np
import pytest
from filter_states import DIRECTIONS, some_state

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.features.repeated_errors import RepeatedErrors, motion

FOCAL_PX, NOISE_PX = 250.0, 0.1


def test_features_have_moved_if_they_are_expected_elsewhere() -> None:
    last = some_state().landmarks
    directions = DIRECTIONS.copy()
    directions[1:3, 0] += np.array([0.4, 0.6]) / FOCAL_PX
    pixels = last.last_pixels + FOCAL_PX * (directions - DIRECTIONS)
    pixels[4] += [0.3, 0.4]
    points_c = 0.4 * np.column_stack([directions, np.ones(len(directions))])
    moved = motion(points_c, pixels, last, np.arange(len(pixels)), FOCAL_PX)
    np.testing.assert_allclose(moved.directions, directions, rtol=1e-15)
    assert moved.unmoved.tolist() == [True, True, False, True, True]
    np.testing.assert_allclose(moved.changes_px2, [0.0, 0.0, 0.0, 0.0, 0.125], atol=1e-12)


def changes(scatter_px: float, count: int = 15) -> Array:
    """Return squared changes of features whose observations scatter by a standard deviation."""
    return scatter_px**2 * np.random.default_rng(1).chisquare(2, count)


@pytest.mark.parametrize('scatter_px, repeat', [(0.0, True), (0.02, True), (0.1, False), (0.2, False)])
def test_the_scatter_of_unmoved_features_decides(scatter_px: float, repeat: bool) -> None:
    errors = RepeatedErrors(NOISE_PX)
    for _ in range(60):
        errors.update(changes(scatter_px))
    assert errors.are_expected(NOISE_PX) == repeat


def test_errors_are_independent_until_features_at_rest_show_otherwise() -> None:
    errors = RepeatedErrors(NOISE_PX)
    images = 0
    while not errors.are_expected(NOISE_PX):
        errors.update(changes(0.2 * NOISE_PX))
        images += 1
    assert 1 <= images < 10
