"""Score statistics by feature: they add up to those of the image, and show errors that stay with one."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.candidate_fit import fit
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.equations.feature_scores import FeatureScatterRecorder, FeatureScores, feature_scores
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.ekf.history.score_statistics import ScoreRecorder, ScoreStatistics
from gyrocal_ros.ekf.state.positive_definite import whitener

FEATURES, IMAGES, STEP_NS = 40, 600, 1_000_000_000
CAMERA = find_effect('focal_length')
GYRO = find_effect('gyro_lag')


def image(seed: int = 0) -> tuple[Array, Array, Array]:
    """Return nu (5, 2), S (5, 2, 5, 2) and G (5, 2, 3) of an image."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(10, 10))
    covariance = (root @ root.T + np.eye(10)).reshape(5, 2, 5, 2)
    return rng.normal(size=(5, 2)), covariance, rng.normal(size=(5, 2, 3))


def test_the_scores_of_the_features_add_up_to_those_of_the_image() -> None:
    residual, covariance, sensitivity = image()
    found = feature_scores(np.arange(5), residual, whitener(covariance.reshape(10, 10)), sensitivity)
    precision, flat = np.linalg.inv(covariance.reshape(10, 10)), sensitivity.reshape(10, 3)
    score, information = found.sums.sum(axis=0)
    np.testing.assert_allclose(score, flat.T @ precision @ residual.ravel())
    np.testing.assert_allclose(information, np.diagonal(flat.T @ precision @ flat), rtol=1e-10)


def test_the_variance_is_that_of_the_scores() -> None:
    _, covariance, sensitivity = image()
    factor = np.linalg.cholesky(covariance.reshape(10, 10))
    rng = np.random.default_rng(1)
    drawn = (factor @ rng.normal(size=(10, 20_000))).T.reshape(-1, 5, 2)
    whitening = whitener(covariance.reshape(10, 10))
    found = [feature_scores(np.arange(5), one, whitening, sensitivity) for one in drawn[:4000]]
    squares, expected = [np.sum(one.sums[:, 0] ** 2, axis=0) for one in found], found[0].variance
    np.testing.assert_allclose(np.mean(squares, axis=0), expected, rtol=0.1)


def recorded(lasting: float, effect: object = CAMERA, value: float = 0.0) -> ScoreStatistics:
    """Return the statistics of images of 10 of 40 features, which change every 150 s.

    Args:
        lasting: standard deviation of an error that stays with a feature; the noise has 1.
        effect: the candidate.
        value: its coefficient.
    """
    rng = np.random.default_rng(3)
    stays = lasting * rng.normal(size=(FEATURES, 1, 2))
    recorder = ScoreRecorder((effect,))  # type: ignore[arg-type]
    for step in range(IMAGES):
        ids: IntArray = np.arange(10) + 10 * (step // 150)
        sensitivity = rng.normal(loc=0.3, size=(10, 2, 1))
        residual = rng.normal(size=(10, 2)) + stays[ids, 0] + value * sensitivity[:, :, 0]
        flat = sensitivity.reshape(20, 1)
        update = UpdateStats(information=flat.T @ flat, score=flat.T @ residual.ravel())
        recorder.add(step * STEP_NS, (update,), feature_scores(ids, residual, np.eye(20), sensitivity))
    return recorder.scores()


def sigma(scores: ScoreStatistics) -> float:
    found = fit(scores, np.array([0]))
    assert found is not None
    return found.sigma


def test_independent_errors_are_as_large_as_the_filter_expects() -> None:
    assert recorded(0.0).excess_of_features(np.array([0]), np.zeros(1))[0] == pytest.approx(1.0, abs=0.3)


def test_errors_that_stay_with_a_feature_make_an_estimate_less_certain() -> None:
    excess = recorded(0.5).excess_of_features(np.array([0]), np.zeros(1))[0]
    # 150 images with a mean sensitivity of 0.3: 1 + 0.25 * 150 * 0.09 / 1.09.
    assert excess == pytest.approx(4.1, rel=0.4)


def test_the_effect_itself_is_no_scatter() -> None:
    scores = recorded(0.0, value=0.5)
    assert scores.excess_of_features(np.array([0]), np.zeros(1))[0] > 10.0
    assert scores.excess_of_features(np.array([0]), np.array([0.5]))[0] == pytest.approx(1.0, abs=0.3)
    assert sigma(scores) == pytest.approx(sigma(recorded(0.0, GYRO, value=0.5)), rel=0.15)


def test_an_effect_on_the_rate_is_judged_by_blocks_of_time_alone() -> None:
    scores = recorded(0.5, GYRO)
    assert scores.excess_of_features(np.array([0]), np.zeros(1))[0] == 1.0
    assert sigma(recorded(0.5, value=0.1)) < 0.9 * sigma(recorded(0.5, GYRO, value=0.1))


def test_lost_features_leave_their_products() -> None:
    kept, forgetful = FeatureScatterRecorder(1), FeatureScatterRecorder(1)
    for step in range(6):
        scores = FeatureScores(np.array([step // 2]), np.array([[[2.0], [3.0]]]), np.ones(1))
        for recorder in (kept, forgetful):
            recorder.add(scores)
        if step % 2:
            forgetful.forget_lost()
    a, b = kept.scatter(), forgetful.scatter()
    assert a is not None and b is not None
    assert a.count == b.count == 3
    assert [float(item[0]) for item in (a.uu, a.ui, a.ii, a.variance)] == [48.0, 72.0, 108.0, 6.0]
    assert [float(item[0]) for item in (b.uu, b.ui, b.ii, b.variance)] == [48.0, 72.0, 108.0, 6.0]


def test_nothing_seen_is_no_scatter() -> None:
    assert FeatureScatterRecorder(2).scatter() is None
