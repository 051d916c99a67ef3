"""Scatter of the estimates: standard deviations that survive errors of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import drive

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.history import scatter as scatter_module
from gyrocal_ros.ekf.history.run import History
from gyrocal_ros.ekf.history.scatter import FORMING, MAX_INFLATION, STRETCH_S, TRACE, Scatter, traces
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, SCALE
from gyrocal_ros.ekf.watches.scale_watch import SETTLE_S

STEPS = 100


def scatter_of(factors: Array, seed: int = 0, first_decrease: float = 0.2, trace: float = 0.0) -> Scatter:
    """Return the scatter of an estimate whose changes are larger than expected by factors (stretches,)."""
    rng, variance, scatter = np.random.default_rng(seed), 1.0, Scatter(np.full(1, trace))
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


@pytest.mark.parametrize(('trace', 'contradicts'), [(0.5, True), (100.0, False)])
def test_changes_too_small_to_matter_do_not_contradict(trace: float, contradicts: bool) -> None:
    scatter = scatter_of(np.full(10, 20.0), trace=trace)
    assert scatter.contradicts is contradicts
    assert scatter.inflation[0] > 10.0, 'the standard deviation is larger all the same'


def test_small_changes_of_what_turns_no_heading_do_not_matter() -> None:
    model = default_model()
    for name in ('rolling_shutter', 'scale_asymmetry'):
        model = with_effect(model, find_effect(name))
    readout = find_effect('rolling_shutter').coefficients[0].typical
    assert readout is not None
    np.testing.assert_allclose(traces(model), [0.0, 0.0, TRACE * readout.low, 0.0])


def test_an_estimate_that_nothing_measures_is_left_alone() -> None:
    scatter = Scatter(np.zeros(2))
    for step in range(100):
        scatter.add(float(step), np.array([0.0, 5.0]), np.array([0.0, 0.01]), np.array([1.0, 1.0]))
    assert scatter.inflation[0] == 1.0 and scatter.inflation[1] > 10.0


JUMP_S, NOISE, CHANGE = 20.0, 2e-3, 0.005
"""Time of a jump of the scale factor, noise of a measurement of it, and the change that shows."""


def estimated(jump: float, lasts_s: float, seed: int = 0, more_at_s: tuple[float, ...] = ()) -> History:
    """Return a history in which each step measures a scale factor of 0 that jumps.

    Args:
        jump: its size.
        lasts_s: time from there for which a change is significant.
        seed: of the noise.
        more_at_s: times of further changes.
    """
    history, rng = drive(duration_s=60.0).run.history, np.random.default_rng(seed)
    time_s, scale = history.time_s, COEFFICIENTS_START
    steps = np.arange(1, len(time_s) + 1)
    true = np.where(time_s > JUMP_S, jump, 0.0)
    mean, std = history.mean.copy(), history.std.copy()
    mean[:, scale] = np.cumsum(true + NOISE * rng.normal(size=len(steps))) / steps
    std[:, scale] = NOISE / np.sqrt(steps)
    decrease = np.zeros_like(history.change_variance)
    decrease[1:, SCALE] = -np.diff(std[:, scale] ** 2)
    is_significant = np.zeros(len(steps), bool)
    for start_s in (JUMP_S, *more_at_s):
        is_significant |= (time_s >= start_s) & (time_s < start_s + lasts_s)
    return replace(
        history,
        mean=mean,
        std=std,
        change=np.zeros_like(decrease),
        change_variance=decrease,
        suspected_std=np.zeros_like(decrease),
        scale_change=np.where(is_significant, CHANGE, 0.0),
        scale_followed=np.zeros_like(history.scale_followed),
    )


def scale_std(history: History) -> Array:
    """Return the standard deviations (s,) of the scale factor."""
    run = replace(drive(duration_s=60.0).run, history=history)
    inflation: Array = scatter_module.scatter_of(run)[1][:, SCALE]
    return inflation * history.std[:, COEFFICIENTS_START]


def test_a_change_adds_while_it_is_significant() -> None:
    for lasts_s in (0.5 * SETTLE_S, 1.5 * SETTLE_S):
        history = estimated(0.0, lasts_s)
        assert scale_std(history)[history.scale_change > 0.0].min() >= CHANGE
    assert scale_std(estimated(0.0, 0.5 * SETTLE_S))[-1] < 1.01 * history.std[-1, COEFFICIENTS_START]


def test_a_change_that_later_measurements_deny_fades() -> None:
    """In the end, only what came later counts: 36 of 60 s."""
    history = estimated(0.0, 1.5 * SETTLE_S)
    stds, last = scale_std(history), np.flatnonzero(history.scale_change)[-1]
    assert stds[last] == pytest.approx(CHANGE, rel=0.01)
    later = history.time_s[-1] - history.time_s[last]
    alone = NOISE / np.sqrt(len(stds) * later / history.time_s[-1])
    assert stds[-1] == pytest.approx(alone, rel=0.15)


@pytest.mark.parametrize('jump', [0.0, 2e-4, 1e-3, CHANGE])
def test_what_a_change_leaves_is_consistent(jump: float) -> None:
    """However large the jump was."""
    z = []
    for seed in range(100):
        history = estimated(jump, 1.5 * SETTLE_S, seed)
        z.append((history.mean[-1, COEFFICIENTS_START] - jump) / scale_std(history)[-1])
    assert np.sqrt(np.mean(np.square(z))) < 1.15


def test_a_change_that_shows_just_before_the_dark_leaves_nothing() -> None:
    history = estimated(0.0, 1.5 * SETTLE_S)
    shown = np.flatnonzero(history.scale_change)
    dof = history.dof.copy()
    dof[shown[len(shown) // 3] :] = 0.0
    std = scale_std(replace(history, dof=dof))[shown[-1] + 1 :]
    assert std.max() < 1.01 * history.std[shown[-1] + 1, COEFFICIENTS_START]


def test_a_change_that_repeats_stays() -> None:
    stds = scale_std(estimated(0.0, 1.5 * SETTLE_S, more_at_s=(35.0,)))
    assert stds[-1] == pytest.approx(CHANGE, rel=0.01)
