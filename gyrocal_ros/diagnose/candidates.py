"""Which effects are put on trial: all that the model lacks and the recording can speak of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.model.sensor import Effect, SensorModel

WARMUP_TIMES_S = (60.0, 180.0, 600.0)
HYSTERESIS_TIMES_S = (4.0, 12.0, 40.0)
NOT_LINEAR = ('rate_saturation', 'rate_deadband')
"""Effects that enter by a limit: told by the readings, not by sensitivities."""

NEEDS_A_RUN = ('wheel_scale', 'focal_length')
"""Effects so weakly observed that the change of the filter's gain with them must not be neglected:
the sensitivity is no guide there, only a run of the filter with the effect in the model is."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A recorded signal that something may follow."""

    name: str
    mean: float
    spread: float
    """Standard deviation; a signal that does not vary is no signal."""


def candidates_for(
    model: SensorModel, signals: Sequence[Signal], has_temperature: bool
) -> tuple[Effect, ...]:
    """Every effect to try beside a model; one with a time constant is tried at several values of it.

    Args:
        model: its own effects are left out.
        signals: recorded signals other than temperature.
        has_temperature: effects of temperature are left out without it.
    """
    present = {effect.name for effect in model.effects}
    found: list[Effect] = []
    for name, effect in EFFECTS.items():
        if name in present or name in NOT_LINEAR or ('temperature' in name and not has_temperature):
            continue
        found.extend(_variants(effect))
    for signal in signals:
        for make in (covariate_bias, covariate_scale):
            effect = make(signal.name, signal.mean, signal.spread)
            if effect.name not in present:
                found.append(effect)
    return tuple(found)


def _variants(effect: Effect) -> list[Effect]:
    if isinstance(effect, BiasWarmup):
        return [_with_time_constant(effect, time_s) for time_s in WARMUP_TIMES_S]
    if isinstance(effect, TurnHysteresis):
        forms = (TurnHysteresis(driven_by='rate'), TurnHysteresis(driven_by='side'))
        return [_with_time_constant(form, time_s) for form in forms for time_s in HYSTERESIS_TIMES_S]
    return [effect]


def _with_time_constant(effect: BiasWarmup | TurnHysteresis, time_s: float) -> Effect:
    amplitude, time_constant = effect.coefficients
    return replace(effect, coefficients=(amplitude, replace(time_constant, prior_mean=time_s)))


def columns_of(candidates: Sequence[Effect]) -> list[IntArray]:
    """Where the coefficients of each candidate stand among all, as index arrays."""
    columns: list[IntArray] = []
    start = 0
    for effect in candidates:
        columns.append(np.arange(start, start + len(effect.coefficients)))
        start += len(effect.coefficients)
    return columns
