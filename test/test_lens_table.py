"""The table of undistorted pixels."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import CameraIntrinsics
from gyrocal_ros.model.camera import bearing
from gyrocal_ros.sim.image_scenes import BARREL, FISHEYE, PINHOLE, RATIONAL
from gyrocal_ros.vision.lens_table import approximate_bearing


@pytest.mark.parametrize(
    ('camera', 'typical_px', 'worst_px'),
    [(BARREL, 0.02, 0.05), (RATIONAL, 0.03, 1.0)],
    ids=['barrel', 'rational'],
)
def test_the_table_is_close(camera: CameraIntrinsics, typical_px: float, worst_px: float) -> None:
    pixels = np.random.default_rng(0).uniform([0.0, 0.0], [639.0, 479.0], (2000, 2))
    approximate = approximate_bearing(camera, pixels)
    assert approximate is not None
    error_px = camera.fx_px * np.linalg.norm(approximate - bearing(camera, pixels), axis=1)
    assert np.median(error_px) < typical_px and error_px.max() < worst_px


def test_outside_the_image_it_is_extrapolated() -> None:
    pixels = np.array([[-10.0, 200.0], [650.0, 240.0]])
    assert approximate_bearing(BARREL, pixels) == pytest.approx(bearing(BARREL, pixels), abs=0.02)


@pytest.mark.parametrize('camera', [PINHOLE, FISHEYE], ids=['pinhole', 'fisheye'])
def test_a_lens_that_is_undone_as_fast_has_no_table(camera: CameraIntrinsics) -> None:
    assert approximate_bearing(camera, np.array([[100.0, 200.0]])) is None
