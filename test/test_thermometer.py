"""Of two effects that look alike while a robot warms up, that of the temperature is taken."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gyrocal_ros.diagnose.search.thermometer import MIN_GAIN, or_by_temperature, price_of_power_on
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import find_effect

LEAST = DEFAULT_SETTINGS.min_predictive_gain


def ranked(name: str, merit: float, *, is_significant: bool = True) -> Any:
    return SimpleNamespace(effect=find_effect(name), merit=merit, is_significant=is_significant)


def taken(
    monkeypatch: pytest.MonkeyPatch,
    other: Any,
    *,
    best: str = 'bias_warmup',
    lost: float = 0.0,
    is_kept: bool = True,
    excluded: frozenset[str] = frozenset(),
) -> str:
    """Return the effect that is taken where a run with another one predicts the recording a little worse."""
    room = 'gyrocal_ros.diagnose.search.thermometer'
    runs = SimpleNamespace(run=None)
    monkeypatch.setattr(
        f'{room}.with_one_more',
        lambda before, effect, *_: SimpleNamespace(effect=effect, after=runs, is_kept=is_kept),
    )
    monkeypatch.setattr(f'{room}.predictive_gain', lambda one, another: np.array([-lost]))
    items = [ranked(best, 1000.0), other]
    before = SimpleNamespace(
        ranked=items,
        settings=DEFAULT_SETTINGS,
        find=lambda name: next(item for item in items if item.effect.name == name),
    )
    added: Any = SimpleNamespace(effect=find_effect(best), before=before, after=runs)
    nothing: Any = None
    return or_by_temperature(added, excluded, nothing, nothing).effect.name


@pytest.mark.parametrize(
    ('other', 'is_taken'),
    [
        (ranked('bias_temperature', 1000.0 - 0.9 * MIN_GAIN), True),
        (ranked('bias_temperature', 1000.0 - 1.1 * MIN_GAIN), False),
        (ranked('bias_temperature', 999.0, is_significant=False), False),
        (ranked('scale_temperature', 999.0), False),
        (ranked('scale_cubic', 999.0), False),
    ],
)
def test_the_temperature_is_tried_if_it_explains_nearly_as_much(
    other: Any, is_taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert taken(monkeypatch, other) == (other.effect.name if is_taken else 'bias_warmup')


def test_a_run_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    other = ranked('bias_temperature', 999.0)
    assert taken(monkeypatch, other, lost=0.9 * LEAST) == 'bias_temperature'
    assert taken(monkeypatch, other, lost=1.1 * LEAST) == 'bias_warmup'
    assert taken(monkeypatch, other, is_kept=False) == 'bias_warmup'


def test_what_was_tried_is_not_taken_again(monkeypatch: pytest.MonkeyPatch) -> None:
    other = ranked('bias_temperature', 999.0)
    assert taken(monkeypatch, other, excluded=frozenset(['bias_temperature'])) == 'bias_warmup'


def test_nothing_takes_the_place_of_another_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    assert taken(monkeypatch, ranked('bias_temperature', 1000.0), best='scale_cubic') == 'scale_cubic'


def test_power_on_in_place_of_the_temperature_has_its_price() -> None:
    warmup, temperature, cubic = map(find_effect, ('bias_warmup', 'bias_temperature', 'scale_cubic'))
    assert price_of_power_on([temperature, cubic], [cubic, warmup]) == MIN_GAIN
    assert price_of_power_on([warmup], [temperature]) == 0.0
    assert price_of_power_on([temperature], [temperature, warmup]) == 0.0, 'both may be there'
    assert price_of_power_on([cubic], [warmup]) == 0.0
