"""Scatter of the estimates: standard deviations that survive errors of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import drive

from gyrocal_ros.data import Array
from gyrocal_ros.ekf import scatter as scatter_module
from gyrocal_ros.ekf.scale_watch import SETTLE_S
from gyrocal_ros.ekf.scatter import FORMING, MAX_INFLATION, STRETCH_S, Scatter
from gyrocal_ros.ekf.state import SCALE

STEPS = 100


def scatter_of(factors: Array, seed: int = 0, first_decrease: float = 0.2) -> Scatter:
    """Return the scatter of an estimate whose changes are larger than expected by factors (stretches,)."""
    rng, variance, scatter = np.random.default_rng(seed), 1.0, Scatter(1)
    dt_s = STRETCH_S / STEPS
    for stretch, factor in enumerate([1.0, *factors, 1.0]):
        part = first_decrease if stretch == 1 else 0.2
        decrease = variance * part / STEPS
        for step in range(STEPS):
            variance -= decrease
            change = factor * np.sqrt(decrease) * rng.normal(size=1)
            scatter.add(stretch * STRETCH_S + step * dt_s, change, np.array([decrease]), np.array([variance]))
    return scatter


def test_changes_as_expected_are_not_inflated_on_average() -> None:
    inflation = [scatter_of(np.ones(30), seed).inflation[0] for seed in range(30)]
    assert np.mean(inflation) < 1.05
    assert not any(scatter_of(np.ones(30), seed).contradicts for seed in range(30))


def test_four_stretches_pay_little_for_chance_and_all_of_an_error_of_the_model() -> None:
    """As many as a minute has; a ratio that is not significant is chance."""
    assert np.mean([scatter_of(np.ones(4), seed).inflation[0] for seed in range(200)]) < 1.05
    assert np.mean([scatter_of(np.full(4, 4.0), seed).inflation[0] for seed in range(200)]) > 3.4


@pytest.mark.parametrize('factor', [5.0, 20.0])
def test_larger_changes_inflate_by_their_factor(factor: float) -> None:
    scatter = scatter_of(np.full(60, factor))
    assert scatter.inflation[0] == pytest.approx(factor, rel=0.2)
    assert scatter.contradicts


def test_an_inflation_that_may_be_chance_does_not_contradict() -> None:
    scatter = scatter_of(np.full(60, 0.9 * MAX_INFLATION), seed=2)
    assert scatter.inflation[0] > 1.3
    assert not scatter.contradicts


def test_a_stretch_that_forms_the_estimate_does_not_count() -> None:
    factors = np.ones(20)
    factors[0] = 50.0
    assert scatter_of(factors, first_decrease=FORMING + 0.1).inflation[0] < 1.6
    assert scatter_of(factors, first_decrease=FORMING - 0.1).inflation[0] > 5.0


def test_few_stretches_do_not_judge() -> None:
    assert not scatter_of(np.full(2, 20.0)).contradicts
    assert not scatter_of(np.full(2, 20.0)).is_judged
    assert scatter_of(np.full(3, 20.0)).contradicts


def test_an_estimate_that_nothing_measures_is_left_alone() -> None:
    scatter = Scatter(2)
    for step in range(100):
        scatter.add(float(step), np.array([0.0, 5.0]), np.array([0.0, 0.01]), np.array([1.0, 1.0]))
    assert scatter.inflation[0] == 1.0 and scatter.inflation[1] > 10.0


@pytest.mark.parametrize('lasting', [True, False])
def test_a_change_of_the_scale_factor_counts_on_where_it_was_significant_for_long(lasting: bool) -> None:
    history = drive(duration_s=60.0).run.history
    after_s = history.time_s - 20.0
    is_significant = (after_s >= 0.0) & (after_s < (1.5 if lasting else 0.5) * SETTLE_S)
    changed = replace(
        history,
        std=np.full_like(history.std, 1e-4),
        scale_change=np.where(is_significant, 0.005, 0.0),
    )
    _, inflations = scatter_module.scatter_of(changed)
    assert inflations[is_significant, SCALE].min() == pytest.approx(50.0, rel=0.05)
    assert (inflations[-1, SCALE] > 40.0) == lasting
