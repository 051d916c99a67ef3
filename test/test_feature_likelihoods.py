"""Likelihood of each feature given the others: what an image tells without it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.history.feature_likelihoods import FeatureLikelihoodRecorder, given_others
from gyrocal_ros.ekf.state.positive_definite import whitener
from gyrocal_ros.pipeline.calibrate import calibrate

COUNT = 5


def log_likelihood(residual: Array, covariance: Array) -> float:
    """Return the log-likelihood of features (m, r) with a covariance (m, r, m, r)."""
    rows = residual.size
    matrix, flat = covariance.reshape(rows, rows), residual.ravel()
    squared = flat @ np.linalg.solve(matrix, flat)
    return float(-0.5 * (squared + np.linalg.slogdet(matrix).logabsdet + rows * math.log(2.0 * math.pi)))


@pytest.mark.parametrize('rows', [1, 2, 3])
def test_an_image_less_one_of_its_features_is_the_image_without_it(rows: int) -> None:
    rng = np.random.default_rng(rows)
    factor = rng.normal(size=(rows * COUNT, rows * COUNT))
    whole, residual = factor @ factor.T + 0.1 * np.eye(rows * COUNT), rng.normal(size=(COUNT, rows))
    covariance, left = whole.reshape(COUNT, rows, COUNT, rows), given_others(residual, whitener(whole))
    for feature in range(COUNT):
        others = np.delete(np.arange(COUNT), feature)
        expected = log_likelihood(residual[others], covariance[others][:, :, others])
        assert log_likelihood(residual, covariance) - left[feature] == pytest.approx(expected)


def test_features_are_kept_by_step() -> None:
    recorder = FeatureLikelihoodRecorder()
    recorder.add(0, MeasurementUpdate(used_ids=np.array([7, 2**40]), given_others=np.array([1.5, 2.5])))
    recorder.add(1, MeasurementUpdate())
    recorder.add(2, MeasurementUpdate(used_ids=np.array([7]), given_others=np.array([-1.0])))
    kept = recorder.likelihoods()
    assert kept.steps.tolist() == [0, 0, 2]
    assert kept.ids.tolist() == [7, 2**40, 7]
    assert kept.log_likelihoods.tolist() == [1.5, 2.5, -1.0]


@pytest.mark.parametrize('follows_changes', [False, True])
def test_a_run_keeps_them_to_be_compared(follows_changes: bool) -> None:
    source = recording('spins', 0, 40.0)
    run = calibrate(source, Config(), default_model(), follows_changes=follows_changes)
    if follows_changes:
        assert run.features is None
        return
    assert run.features is not None
    used = np.bincount(run.features.steps, minlength=len(run.history.used))
    np.testing.assert_array_equal(used, run.history.used)
