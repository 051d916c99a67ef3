"""Other combinations of effects than what a search found step by step, with a filter made of numbers."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from test_search import AT_REST, MIN_GAIN, FakeFilter

from gyrocal_ros.diagnose.diagnosis import diagnose
from gyrocal_ros.diagnose.search import alternatives
from gyrocal_ros.diagnose.search.additions import Addition, Search
from gyrocal_ros.diagnose.search.alternatives import best_alternative, searched_again
from gyrocal_ros.diagnose.search.search import MAX_ADDITIONS, search
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import default_model, find_effect

BOTH = 450.0
"""Predictive log-likelihood that the two effects found gain together."""
PRICE = DEFAULT_SETTINGS.coefficient_price + 0.5 * DEFAULT_SETTINGS.significant_sigma**2
NAMES = ['gyro_lag', 'scale_cubic']


def found_by(fake: FakeFilter) -> Search:
    """Search with a filter to which the lag shows most, the cubic next; a slip shows as the cubic does."""
    return search(default_model(), AT_REST, fake, most=2)


def alternative(fake: FakeFilter, found: Search) -> list[str]:
    best = best_alternative(found, AT_REST, fake, MAX_ADDITIONS)
    return [item.effect.name for item in best.kept]


@pytest.mark.slow
@pytest.mark.parametrize(
    ('alone', 'is_better'), [(BOTH + 2.0 * MIN_GAIN, True), (BOTH - PRICE - MIN_GAIN, False)]
)
def test_an_effect_that_others_look_like_is_contested_with_all_that_follows(
    alone: float, is_better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it a slip is found, which predicts as well as both."""
    fake = FakeFilter(
        {'gyro_lag': 3.0, 'scale_cubic': 1.0},
        {'gyro_lag': 400.0, 'turn_slip': alone},
        beside={'gyro_lag': BOTH - 90.0, 'scale_cubic': 90.0, 'turn_slip': 0.0},
    )
    found = found_by(fake)
    assert [item.effect.name for item in found.kept] == NAMES
    monkeypatch.setattr(alternatives, 'look_alikes', lambda searched: {'gyro_lag': ('turn_slip',)})
    fake.hidden = {'turn_slip': 3.0}
    without = search(default_model(), AT_REST, fake, most=1)
    monkeypatch.setattr(alternatives, 'continued', lambda *about: without.additions)
    assert alternative(fake, found) == (['turn_slip'] if is_better else NAMES)


@pytest.mark.slow
def test_an_effect_that_is_only_left_out_is_no_alternative(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeFilter(
        {'gyro_lag': 3.0, 'scale_cubic': 2.0},
        {'gyro_lag': 400.0, 'scale_cubic': 2.0 * BOTH},
        beside={'gyro_lag': BOTH - 90.0, 'scale_cubic': 90.0},
    )
    found = found_by(fake)
    assert [item.effect.name for item in found.kept] == NAMES
    tried = len(fake.models)
    assert alternative(fake, found) == NAMES and len(fake.models) == tried, 'nothing looks like them'
    monkeypatch.setattr(alternatives, 'look_alikes', lambda searched: {'gyro_lag': ('turn_slip',)})
    assert alternative(fake, found) == NAMES
    assert all('gyro_lag' not in names for names in fake.models[tried:]) and len(fake.models) > tried


@pytest.mark.slow
def test_an_alternative_that_is_far_behind_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeFilter(
        {'gyro_lag': 3.0, 'scale_cubic': 1.0},
        {'gyro_lag': 400.0, 'turn_slip': 0.0},
        beside={'gyro_lag': BOTH - 90.0, 'scale_cubic': 90.0, 'turn_slip': 0.0},
    )
    found = found_by(fake)
    monkeypatch.setattr(alternatives, 'look_alikes', lambda searched: {'gyro_lag': ('turn_slip',)})
    given_up: list[bool] = []

    def continued(additions: list[Addition], *others: Any) -> list[Addition]:
        given_up.extend(map(others[-1], (found.first, found.last)))
        return additions

    monkeypatch.setattr(alternatives, 'continued', continued)
    assert best_alternative(found, AT_REST, fake, MAX_ADDITIONS) is found
    assert given_up == [True, False]


def test_one_effect_alone_was_contested_by_the_search() -> None:
    fake = FakeFilter({'gyro_lag': 3.0}, {'gyro_lag': 400.0})
    found = found_by(fake)
    assert len(found.kept) == 1 and best_alternative(found, AT_REST, fake, MAX_ADDITIONS) is found


@pytest.mark.parametrize(('alone', 'named'), [(900.0, 'turn_slip'), (300.0, 'gyro_lag')])
def test_an_effect_that_displaces_another_takes_its_place_where_it_predicts_better(
    alone: float, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeFilter({'gyro_lag': 3.0}, {'gyro_lag': 400.0, 'turn_slip': alone})
    found = found_by(fake)
    monkeypatch.setattr(alternatives, '_displacing', lambda searched, item: find_effect('turn_slip'))
    fake.hidden = {'turn_slip': 3.0}
    assert alternative(fake, found) == [named]


@pytest.mark.parametrize(('left', 'displaces'), [(0.1, True), (0.3, False)])
def test_an_effect_of_which_little_is_left_is_displaced(left: float, displaces: bool) -> None:
    """A principal point that was tried beside a camera that seemed to be elsewhere."""
    values = {'before': np.array([0.03, 0.04]), 'after': left * np.array([0.03, 0.04])}
    models = {
        when: SimpleNamespace(
            model=SimpleNamespace(effects=[find_effect('camera_position')]),
            estimate_of=lambda name, value=value: (value, None),
        )
        for when, value in values.items()
    }
    kept = SimpleNamespace(effect=find_effect('camera_position'), strengths=np.array([0, 1]))
    rejected = SimpleNamespace(
        is_kept=False, predictive_gain=600.0, effect=find_effect('principal_point'), **models
    )
    settings = SimpleNamespace(settings=DEFAULT_SETTINGS)
    searched = cast('Search', SimpleNamespace(first=settings, additions=[kept_first(kept), rejected]))
    found = alternatives._displacing(searched, cast('Addition', kept))
    assert (None if found is None else found.name) == ('principal_point' if displaces else None)


def kept_first(kept: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(is_kept=True, effect=kept.effect)


RECOVERED = 'camera_time_offset'


def recovered(hidden: dict[str, float], gains: dict[str, float]) -> tuple[FakeFilter, Search]:
    """Search with a filter that diverges without a time offset as long as a cubic is missing."""
    fake = FakeFilter({'scale_cubic': 3.0, **hidden}, gains, diverges_without=RECOVERED)
    found = search(default_model(), AT_REST, fake)
    assert [item.effect.name for item in found.kept] == [RECOVERED, 'scale_cubic']
    assert found.additions[0].before is None
    return fake, found


def test_what_a_run_recovered_with_goes_where_it_is_not_needed_any_more() -> None:
    fake, found = recovered({}, {'scale_cubic': 400.0})
    fake.diverges_without = ''
    again = searched_again(found, AT_REST, fake, MAX_ADDITIONS)
    assert [item.effect.name for item in again.removals] == [RECOVERED]
    assert [item.effect.name for item in again.kept] == ['scale_cubic']
    assert [effect.name for effect in again.last.model.effects] == ['scale_factor', 'scale_cubic']


def test_what_a_run_recovered_with_is_found_again_where_it_shows() -> None:
    fake, found = recovered({RECOVERED: 2.0}, {'scale_cubic': 400.0, RECOVERED: 90.0})
    fake.diverges_without = ''
    again = searched_again(found, AT_REST, fake, MAX_ADDITIONS)
    assert [item.effect.name for item in again.kept] == ['scale_cubic', RECOVERED]
    assert again.kept[-1].before is not None and again.kept[-1].gain < math.inf
    assert [item.effect.name for item in diagnose(again, AT_REST).missing] == ['scale_cubic', RECOVERED]


def test_what_a_run_recovered_with_stays_where_the_rest_predicts_worse() -> None:
    fake, found = recovered({}, {'scale_cubic': 400.0, RECOVERED: 90.0})
    fake.diverges_without = ''
    assert searched_again(found, AT_REST, fake, MAX_ADDITIONS) is found


def test_what_the_filter_cannot_run_without_stays() -> None:
    fake, found = recovered({}, {'scale_cubic': 400.0})
    assert searched_again(found, AT_REST, fake, MAX_ADDITIONS) is found
