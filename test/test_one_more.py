"""Runs with one more effect: those with known time constants decide between these, and between forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest
from synthetic import drive

from gyrocal_ros.diagnose.search import one_more
from gyrocal_ros.diagnose.search.one_more import (
    KNOWN_PART,
    LEAST_PART,
    MAX_STEPS,
    STEP,
    _from_likeliest,
    with_one_more,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.traits import forms_of
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means

EFFECT = find_effect('turn_hysteresis')
STRENGTH, TIME_CONSTANT = 0, 1
START_S = 10.0
MADE = drive(duration_s=30.0).run
PRESENT: Any = SimpleNamespace(run=MADE)


@dataclass
class FakeFilter:
    """Runs whose log-likelihood is a function of the last effect of the model."""

    log_likelihood: Callable[[Effect], float]
    runs: int = 0

    def __call__(self, model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        self.runs += 1
        last = model.effects[-1]
        item = last.coefficients[TIME_CONSTANT]
        assert item.prior_std == pytest.approx(KNOWN_PART * item.prior_mean), 'the time constant is known'
        values = MADE.history.log_likelihood.copy()
        values[0] += self.log_likelihood(last)
        return replace(MADE, history=replace(MADE.history, log_likelihood=values))


def model_with(effect: Effect, start_s: float = START_S) -> SensorModel:
    model = default_model()
    return replace(model, effects=(*model.effects, with_means(effect, (0.01, start_s))))


def tau_s(effect: Effect) -> float:
    return effect.coefficients[TIME_CONSTANT].prior_mean


@pytest.mark.parametrize(('true_s', 'part'), [(9.3, 0.02), (17.0, 0.02), (6.0, 0.02), (12.0, 0.12)])
def test_a_time_constant_starts_where_runs_predict_best(true_s: float, part: float) -> None:
    fake = FakeFilter(lambda effect: -0.5 * (math.log(tau_s(effect) / true_s) / part) ** 2)
    wider = model_with(EFFECT)
    started = _from_likeliest(wider, TIME_CONSTANT, PRESENT, fake)
    before, after = wider.effects[-1].coefficients, started.effects[-1].coefficients
    assert after[TIME_CONSTANT].prior_mean == pytest.approx(true_s)
    expected = min(max(LEAST_PART, 2.0 * part) * true_s, before[TIME_CONSTANT].prior_std)
    assert after[TIME_CONSTANT].prior_std == pytest.approx(expected)
    assert after[STRENGTH] == before[STRENGTH]
    assert fake.runs <= 2 * MAX_STEPS


def test_a_time_constant_may_be_beyond_the_scan() -> None:
    """There the effect is negligible, or not that effect, which the run has to show."""
    least_s = min(EFFECT.coefficients[TIME_CONSTANT].scan)
    fake = FakeFilter(lambda effect: -0.5 * (math.log(tau_s(effect) / (0.6 * least_s)) / 0.1) ** 2)
    started = _from_likeliest(model_with(EFFECT, least_s), TIME_CONSTANT, PRESENT, fake)
    assert tau_s(started.effects[-1]) == pytest.approx(0.6 * least_s)


def test_the_search_for_a_time_constant_ends() -> None:
    fake = FakeFilter(tau_s)
    started = _from_likeliest(model_with(EFFECT), TIME_CONSTANT, PRESENT, fake)
    assert START_S < tau_s(started.effects[-1]) <= START_S * STEP ** (MAX_STEPS + 0.5)


def test_a_time_constant_with_which_the_filter_diverges_is_not_taken() -> None:
    def log_likelihood(effect: Effect) -> float:
        if tau_s(effect) > 1.01 * START_S:
            raise FilterDivergedError('lost the measurements')
        return tau_s(effect)

    started = _from_likeliest(model_with(EFFECT), TIME_CONSTANT, PRESENT, FakeFilter(log_likelihood))
    item = started.effects[-1].coefficients[TIME_CONSTANT]
    assert item.prior_mean == pytest.approx(START_S)
    assert item.prior_std == pytest.approx(LEAST_PART * START_S)

    def never(effect: Effect) -> float:
        raise FilterDivergedError('lost the measurements')

    wider = model_with(EFFECT)
    assert _from_likeliest(wider, TIME_CONSTANT, PRESENT, FakeFilter(never)) is wider


@pytest.mark.parametrize(
    ('part', 'diverges', 'is_free'), [(0.9, False, True), (0.9, True, False), (1.1, False, False)]
)
def test_slow_errors_of_images_are_no_reason_to_know_a_time_constant(
    part: float, diverges: bool, is_free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that is free finds that they have none; where it diverges, a known one is nearer."""
    examined: list[SensorModel] = []

    def examine(model: SensorModel, *about: object) -> SensorModel:
        examined.append(model)
        if diverges and len(examined) == 1:
            raise FilterDivergedError('lost the measurements')
        return model

    monkeypatch.setattr(one_more, 'wider_model', lambda present, effect: model_with(effect))
    monkeypatch.setattr(one_more, 'examine', examine)
    monkeypatch.setattr(one_more, 'addition', lambda present, after: after)
    gained = SimpleNamespace(merit=part * DEFAULT_SETTINGS.uneven_view_gain)
    present: Any = SimpleNamespace(run=MADE, settings=DEFAULT_SETTINGS, find=lambda name: gained)
    fake, recording = FakeFilter(lambda effect: -((math.log(tau_s(effect) / 17.0) / 0.1) ** 2)), Any
    started: Any = with_one_more(present, EFFECT, recording, fake)  # type: ignore[arg-type]
    assert tau_s(started.effects[-1]) == pytest.approx(START_S if is_free else 17.0)
    assert (fake.runs == 0) == is_free


def test_runs_decide_between_the_forms_of_an_effect() -> None:
    first, second = forms_of(EFFECT)
    for likelier in (first, second):
        name = likelier.driven_by  # type: ignore[attr-defined]
        fake = FakeFilter(lambda effect, name=name: 5.0 * (effect.driven_by == name))  # type: ignore[misc]
        started = _from_likeliest(model_with(first), TIME_CONSTANT, PRESENT, fake)
        assert started.effects[-1].driven_by == name  # type: ignore[attr-defined]
        assert tau_s(started.effects[-1]) == START_S
        assert fake.runs == 4, 'each form once, and the time constants on both sides'


def test_an_effect_of_one_form_needs_no_run_for_it() -> None:
    fake = FakeFilter(lambda effect: 0.0)
    _from_likeliest(model_with(find_effect('bias_warmup')), TIME_CONSTANT, PRESENT, fake)
    assert fake.runs == 3
