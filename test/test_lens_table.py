"""The table from which Newton's method starts to undo a lens."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import CameraIntrinsics
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.sim.image_scenes import BARREL, FISHEYE, PINHOLE, RATIONAL
from gyrocal_ros.vision.lens_table import approximate_bearing


@pytest.mark.parametrize('camera', [BARREL, RATIONAL], ids=['barrel', 'rational'])
def test_the_table_is_close_and_the_result_exact(camera: CameraIntrinsics) -> None:
    pixels = np.random.default_rng(0).uniform([0.0, 0.0], [639.0, 479.0], (500, 2))
    start = approximate_bearing(camera, pixels)
    assert start is not None
    found = bearing(camera, pixels, start)
    assert np.abs(start - found).max() < 0.02
    assert np.median(np.abs(start - found)) < 1e-3
    back = project(camera, np.column_stack([found, np.ones(500)]))
    assert back == pytest.approx(pixels, abs=1e-6)
    assert found == pytest.approx(bearing(camera, pixels), abs=1e-8)


def test_outside_the_image_the_result_is_exact_too() -> None:
    pixels = np.array([[-30.0, -20.0], [660.0, 240.0]])
    found = bearing(BARREL, pixels, approximate_bearing(BARREL, pixels))
    assert found == pytest.approx(bearing(BARREL, pixels), abs=1e-8)


@pytest.mark.parametrize('camera', [PINHOLE, FISHEYE], ids=['pinhole', 'fisheye'])
def test_a_lens_that_needs_no_start_has_no_table(camera: CameraIntrinsics) -> None:
    assert approximate_bearing(camera, np.array([[100.0, 200.0]])) is None
