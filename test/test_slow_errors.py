"""Errors of tracks that change with the view, and not from image to image."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from filter_states import some_state
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, FeatureObservations, Measurement
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.slow_errors import (
    LEAST_PX,
    MAX_MOTION_PX,
    MOST_PX,
    SlowErrors,
    differences,
    with_slow_errors,
)
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.sim.sensors import SensorErrors

IDS = np.arange(15)
NOISE_PX = 0.05
ERRORS = replace(SensorErrors(), pixel_noise_px=NOISE_PX)


def learned(correlation: float, images: int, size: float = 1.0) -> SlowErrors:
    """Return what innovations of unit variance tell whose successive ones are correlated."""
    rng, slow = np.random.default_rng(4), SlowErrors()
    errors = rng.normal(size=(len(IDS), 2))
    for _ in range(images):
        new = rng.normal(size=(len(IDS), 2))
        errors = correlation * errors + np.sqrt(1.0 - correlation**2) * new
        slow.learn(IDS, size * errors)
    return slow


@pytest.mark.parametrize('correlation', [-0.3, 0.0, 0.03])
def test_independent_innovations_make_no_walk(correlation: float) -> None:
    assert learned(correlation, 2000).variance_px == 0.0


def test_a_walk_grows_while_successive_innovations_are_alike() -> None:
    few, many = (learned(0.5, images).variance_px for images in (20, 40))
    assert 2.0 * LEAST_PX < few < many < MOST_PX
    assert learned(0.5, 200).variance_px == pytest.approx(MOST_PX)


def test_outliers_count_little() -> None:
    assert learned(0.5, 30, size=100.0).variance_px <= learned(0.5, 30, size=3.0).variance_px * 1.5


def test_a_walk_that_is_too_large_shrinks_again() -> None:
    slow = learned(0.5, 60)
    before = slow.variance_px
    sign = np.ones((len(IDS), 2))
    for _ in range(10):
        sign = -sign
        slow.learn(IDS, sign)
    assert 0.0 <= slow.variance_px < 0.5 * before


def test_features_that_have_not_moved_and_those_seen_before_the_last_image_tell_nothing() -> None:
    slow, alike = SlowErrors(), np.full((len(IDS), 2), 2.0)
    for _ in range(30):
        slow.learn(IDS, np.full_like(alike, np.nan))
        slow.learn(IDS, alike)
        slow.learn(IDS[:0], alike[:0])
        slow.learn(IDS, alike)
        slow.learn(IDS + 100, alike)
    assert slow.variance_px == 0.0


def test_directions_walk_with_the_motion_in_the_image() -> None:
    state, rows, focal_px = some_state(), np.array([0, 3]), 250.0
    moved: Array = np.array([10.0, 2.0 * MAX_MOTION_PX])
    after = with_slow_errors(state, rows, moved, 1e-4, focal_px)
    added = after.covariance - state.covariance
    columns = state.feature_columns(rows)
    expected = np.zeros_like(added)
    for feature, motion_px in zip(columns, (10.0, MAX_MOTION_PX), strict=True):
        expected[feature[:2], feature[:2]] = 1e-4 * motion_px / focal_px**2
    np.testing.assert_allclose(added, expected, atol=1e-15)


def some_image(rng: np.random.Generator, count: int = 15) -> tuple[Array, Array, Array]:
    """Return an innovation of noise, its whitening, and the derivative by what features have in common."""
    residual, common = rng.normal(size=(count, 2)), rng.normal(size=(count, 2, 6))
    factor = rng.normal(size=(2 * count, 2 * count))
    covariance = np.eye(2 * count) + 0.1 * factor @ factor.T
    residual = (np.linalg.cholesky(covariance) @ residual.ravel()).reshape(count, 2)
    return residual, whitener(covariance), common


def test_differences_of_noise_have_unit_covariance() -> None:
    rng = np.random.default_rng(5)
    found = np.concatenate([differences(*some_image(rng)) for _ in range(400)])
    np.testing.assert_allclose(np.cov(found.T), np.eye(2), atol=0.05)


def test_what_features_have_in_common_makes_no_difference() -> None:
    residual, whitening, common = some_image(np.random.default_rng(6))
    moved = residual + common @ np.array([30.0, -20.0, 10.0, 5.0, -40.0, 25.0])
    found = differences(residual, whitening, common)
    np.testing.assert_allclose(differences(moved, whitening, common), found, atol=1e-9)
    assert np.abs(found).max() > 1.0


def test_a_feature_that_alone_is_off_differs() -> None:
    residual, whitening, common = some_image(np.random.default_rng(7))
    residual[4] += [30.0, 0.0]
    assert np.argmax((differences(residual, whitening, common) ** 2).sum(axis=1)) == 4


def test_too_few_features_do_not_differ() -> None:
    residual, whitening, common = some_image(np.random.default_rng(8), count=5)
    assert len(differences(residual, whitening, common)) == 0


class SlowlyWrong:
    """Adds to features that a tracker of images tells the quality of an error that changes with their motion.

    Args:
        variance_px: of the error, px^2 per px of motion.
        has_covariances: False for features that come without.
    """

    def __init__(self, variance_px: float, *, has_covariances: bool = True) -> None:
        self._variance_px, self._has_covariances = variance_px, has_covariances
        self._errors: dict[int, tuple[Array, Array]] = {}
        self._rng = np.random.default_rng(9)

    def __call__(self, measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for item in measurements:
            yield self._changed(item) if isinstance(item, FeatureObservations) else item

    def _changed(self, seen: FeatureObservations) -> FeatureObservations:
        pixels = seen.pixels.copy()
        for row, id_ in enumerate(seen.ids.tolist()):
            error, before = self._errors.get(id_, (np.zeros(2), pixels[row]))
            moved_px = np.linalg.norm(pixels[row] - before)
            error = error + np.sqrt(self._variance_px * moved_px) * self._rng.normal(size=2)
            self._errors[id_] = error, seen.pixels[row]
            pixels[row] += error
        covariances = np.tile(NOISE_PX**2 * np.eye(2), (len(pixels), 1, 1))
        return replace(seen, pixels=pixels, covariances_px2=covariances if self._has_covariances else None)


def learned_from(errors: SlowlyWrong) -> float:
    """Return the variance of the walk that a filter learns from a recording with such features."""
    source = ModifiedSource(recording('cleaning', 3, 40.0, camera_hz=10, errors=ERRORS), errors)
    slam = EkfSlam(default_model(), Config(), source.rig)
    slam.expect_pixel_noise(NOISE_PX)
    stream = SlamStream(slam)
    for item in source.measurements():
        stream.step(item)
    stream.finish()
    return slam.track_noise.slow_variance_px


@pytest.mark.parametrize('has_covariances', [True, False])
def test_the_walk_of_tracks_that_err_slowly_is_learned(has_covariances: bool) -> None:
    true_px = 3e-5
    learned_px = learned_from(SlowlyWrong(true_px, has_covariances=has_covariances))
    assert true_px / 3.0 < learned_px < 3.0 * true_px


@pytest.mark.parametrize('has_covariances', [True, False])
def test_tracks_with_white_noise_do_not_walk(has_covariances: bool) -> None:
    assert learned_from(SlowlyWrong(0.0, has_covariances=has_covariances)) == 0.0
