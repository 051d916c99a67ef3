"""Errors of whole tracks against true poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.bench.bag_tracks import bag_track_errors
from gyrocal_ros.bench.track_errors import Views, track_errors, track_row, triangulate
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations, nanoseconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.rotation import rotation_from_euler

BAGS = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'foreign-images'
CAMERA = CameraIntrinsics(640, 480, 250.0, 250.0, 320.0, 240.0, (-0.05, 0.01, 5e-4, -3e-4, 0.0))
SLOW_PX, SLOW_STD_PX = 0.07, 0.005
"""Slow part of the errors that a track may have, and the least standard deviation of its median."""
POINTS_W = np.random.default_rng(0).uniform([-1.0, -1.0, 2.3], [1.5, 1.0, 2.6], (30, 3))
IMAGES = 200
R_WC = np.array([rotation_from_euler(np.array([0.01, -0.02, 0.01 * k])) for k in range(IMAGES)])
P_WC = np.column_stack([np.linspace(-0.5, 0.7, IMAGES), np.zeros(IMAGES), np.full(IMAGES, 0.1)])


def observed(k: int, errors_px: Array) -> FeatureObservations:
    """Return the pixels of all points in image k, with errors."""
    pixels = project(CAMERA, (POINTS_W - P_WC[k]) @ R_WC[k]) + errors_px
    return FeatureObservations(nanoseconds(0.1 * k), np.arange(len(POINTS_W)), pixels)


def test_a_point_is_triangulated_from_its_views() -> None:
    pixels = np.array([observed(k, np.zeros(2)).pixels[3] for k in range(IMAGES)])
    point_w, errors = triangulate(CAMERA, Views(pixels, R_WC, P_WC))
    assert point_w == pytest.approx(POINTS_W[3], abs=1e-8)
    assert np.abs(errors).max() < 1e-6


def test_white_and_slow_errors_of_a_track_are_told_apart() -> None:
    rng = np.random.default_rng(1)
    phase = rng.uniform(0.0, 6.0, (len(POINTS_W), 2))
    slow = [0.3 * np.sqrt(2.0) * np.sin(0.1 * k + phase) for k in range(IMAGES)]
    white = rng.normal(0.0, 0.1, (IMAGES, len(POINTS_W), 2))
    row = track_row(
        [track_errors(CAMERA, [observed(k, slow[k] + white[k]) for k in range(IMAGES)], R_WC, P_WC)]
    )
    assert row['tracks'] == len(POINTS_W)
    assert row['rms_px'] == pytest.approx(0.316, abs=0.02)
    assert row['white_px'] == pytest.approx(0.104, abs=0.01)
    assert row['slow_px'] == pytest.approx(0.3, abs=0.02)


def test_images_at_rest_do_not_count() -> None:
    rng = np.random.default_rng(2)
    seen = [observed(k, rng.normal(0.0, 0.1, (len(POINTS_W), 2))) for k in range(IMAGES)]
    rest = [observed(0, np.full(2, 0.3))] * IMAGES
    poses = (
        np.concatenate([R_WC[:1].repeat(IMAGES, axis=0), R_WC]),
        np.concatenate([P_WC[:1]] * IMAGES + [P_WC]),
    )
    errors = track_errors(CAMERA, rest + seen, *poses)
    assert float(np.median(errors.rms_px)) == pytest.approx(0.1, abs=0.02)


def test_without_parallax_there_is_no_track() -> None:
    errors = track_errors(CAMERA, [observed(k, np.zeros(2)) for k in range(IMAGES)][:12], R_WC, 0.0 * P_WC)
    assert track_row([errors])['tracks'] == 0


@pytest.mark.thorough
def test_the_tracks_of_another_simulator_are_accurate() -> None:
    if not BAGS.exists():
        pytest.skip('no foreign-images beside the project')
    row = track_row([bag_track_errors(BAGS / 'soft', Config())])
    assert row['tracks'] > 50
    assert row['rms_px'] < 0.16
    assert row['slow_px'] < SLOW_PX + 2.0 * SLOW_STD_PX


def test_a_recording_without_true_poses_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        bag_track_errors(tmp_path / 'missing', Config())
