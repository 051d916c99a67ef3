"""Of two effects that look alike while a robot warms up, that of the temperature is taken."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gyrocal_ros.diagnose.search.thermometer import ALIKE_PART, MIN_GAIN, or_by_temperature, price_of_power_on
from gyrocal_ros.effects import find_effect


def ranked(name: str, merit: float, *, is_significant: bool = True) -> Any:
    return SimpleNamespace(effect=find_effect(name), merit=merit, is_significant=is_significant)


WARMUP = ranked('bias_warmup', 1000.0)


@pytest.mark.parametrize(
    ('other', 'is_taken'),
    [
        (ranked('bias_temperature', 1010.0 * ALIKE_PART), True),
        (ranked('bias_temperature', 990.0 * ALIKE_PART), False),
        (ranked('bias_temperature', 999.0, is_significant=False), False),
        (ranked('scale_temperature', 999.0), False),
        (ranked('scale_cubic', 999.0), False),
    ],
)
def test_the_temperature_is_taken_if_it_explains_nearly_as_much(other: Any, is_taken: bool) -> None:
    assert or_by_temperature(WARMUP, [WARMUP, other], set()) is (other if is_taken else WARMUP)


def test_what_was_tried_is_not_taken_again() -> None:
    other = ranked('bias_temperature', 999.0)
    assert or_by_temperature(WARMUP, [WARMUP, other], {'bias_temperature'}) is WARMUP


def test_nothing_takes_the_place_of_another_effect() -> None:
    cubic, temperature = ranked('scale_cubic', 1000.0), ranked('bias_temperature', 1000.0)
    assert or_by_temperature(cubic, [cubic, temperature], set()) is cubic


def test_power_on_in_place_of_the_temperature_has_its_price() -> None:
    warmup, temperature, cubic = map(find_effect, ('bias_warmup', 'bias_temperature', 'scale_cubic'))
    assert price_of_power_on([temperature, cubic], [cubic, warmup]) == MIN_GAIN
    assert price_of_power_on([warmup], [temperature]) == 0.0
    assert price_of_power_on([temperature], [temperature, warmup]) == 0.0, 'both may be there'
    assert price_of_power_on([cubic], [warmup]) == 0.0
