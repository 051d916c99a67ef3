"""Predictive log-likelihood: the gain of one run over another, by blocks of time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from synthetic import DT_S, drive

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.ekf.history.feature_likelihoods import FeatureLikelihoods
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S

DURATION_S = 100.0


def run_with(log_likelihood: Array | float, dof: Array | float = 1.0) -> Run:
    made = drive(duration_s=DURATION_S).run
    full = np.ones(len(made.history.time_s))
    return replace(made, history=replace(made.history, log_likelihood=log_likelihood * full, dof=dof * full))


def test_it_is_the_difference_of_the_log_likelihoods_by_block() -> None:
    ramp = np.linspace(0.0, 1.0, round(DURATION_S / DT_S))
    gains = predictive_gain(run_with(1.0), run_with(1.0 + ramp))
    each = round(BLOCK_S / DT_S)
    np.testing.assert_allclose(gains, ramp.reshape(-1, each).sum(axis=1))
    back = predictive_gain(run_with(1.0 + ramp), run_with(1.0))
    np.testing.assert_allclose(back.sum(), -ramp.sum(), rtol=0.01)


def test_more_features_are_no_gain() -> None:
    """Twice as many features, each predicted as well as before."""
    np.testing.assert_allclose(predictive_gain(run_with(-2.0, 4.0), run_with(-4.0, 8.0)), 0.0, atol=1e-9)
    better = predictive_gain(run_with(-2.0, 4.0), run_with(-3.0, 8.0))
    assert better.sum() == pytest.approx(1000.0)


def test_a_heading_that_is_not_used_counts_as_unknown() -> None:
    """Else a run that takes every turn for a jump of the reference would predict best."""

    def by_heading(rejected: int) -> Run:
        made = run_with(1.0, (np.arange(round(DURATION_S / DT_S)) >= rejected).astype(float))
        history, dof = made.history, made.history.dof
        history = replace(
            history, log_likelihood=dof * history.log_likelihood, rejected=(dof == 0).astype(int)
        )
        return replace(made, history=history, rig=replace(made.rig, camera=None))

    gain = predictive_gain(by_heading(20), by_heading(0)).sum()
    assert gain == pytest.approx(20 * (1.0 + math.log(2.0 * math.pi)))
    in_images = [replace(by_heading(rejected), rig=drive().run.rig) for rejected in (20, 0)]
    assert predictive_gain(*in_images).sum() == pytest.approx(0.0, abs=1e-9)


class TestFeaturesOfTwoRuns:
    """Runs whose images each have features of some log-likelihood, independent of each other."""

    @staticmethod
    def run_of(features: Mapping[int, float], steps: slice = slice(None)) -> Run:
        """Return a run of which some steps use features, by id; the others have a usual measurement."""
        run = run_with(-2.0, 2.0)
        log_likelihood, dof = run.history.log_likelihood.copy(), run.history.dof.copy()
        log_likelihood[steps], dof[steps] = sum(features.values()), 2.0 * len(features)
        numbers = np.arange(len(dof))[steps]
        likelihoods = FeatureLikelihoods(
            np.repeat(numbers, len(features)),
            np.tile(np.array([*features], np.int64), len(numbers)),
            np.tile([*features.values()], len(numbers)),
        )
        history = replace(run.history, log_likelihood=log_likelihood, dof=dof)
        return replace(run, history=history, features=likelihoods)

    def test_those_count_that_both_use(self) -> None:
        before = self.run_of({1: -2.0, 2: -2.0, 3: -2.0, 7: -9.0})
        after = self.run_of({1: -1.9, 2: -2.0, 3: -2.0, 9: 5.0})
        gains = predictive_gain(before, after)
        np.testing.assert_allclose(gains, 0.1 * BLOCK_S / DT_S, rtol=1e-5)
        np.testing.assert_allclose(predictive_gain(after, before), -gains)

    def test_by_image(self) -> None:
        before = self.run_of({1: -2.0, 2: -2.0, 3: -5.0}, slice(0, None, 2))
        after = self.run_of({1: -2.0, 2: -1.5}, slice(0, None, 2))
        np.testing.assert_allclose(predictive_gain(before, after), 0.25 * BLOCK_S / DT_S, rtol=1e-5)

    def test_all_count_as_usual_where_few_are_shared(self) -> None:
        before, after = self.run_of({1: -2.0, 2: -2.0, 3: -2.0}), self.run_of({1: -1.0, 8: -2.5, 9: -2.5})
        np.testing.assert_allclose(predictive_gain(before, after), 0.0, atol=1e-3)
        kept = replace(after, features=None)
        np.testing.assert_allclose(predictive_gain(before, after), predictive_gain(before, kept))

    def test_an_image_that_one_run_rejects_tells_nothing(self) -> None:
        none = self.run_of({}, slice(0, None, 2))
        np.testing.assert_allclose(predictive_gain(self.run_of({1: -2.0, 2: -2.0}), none), 0.0, atol=1e-3)


def test_a_run_that_ended_earlier_gains_nothing_later() -> None:
    short = run_with(3.0)
    half = {name: getattr(short.history, name)[:500] for name in ('time_s', 'log_likelihood', 'dof', 't_ns')}
    gains = predictive_gain(run_with(1.0), replace(short, history=replace(short.history, **half)))
    assert len(gains) == round(DURATION_S / BLOCK_S)
    assert np.all(gains[:5] > 0.0)
