"""Random draws of the effects that a recording hides, and of their sizes.

All draws depend on the seed alone. Every shipped effect whose coefficients have a typical range takes part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.effects import SHIPPED
from gyrocal_ros.effects.covariate import covariate_effects
from gyrocal_ros.effects.traits import is_noise
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.recording import Signal
from gyrocal_ros.model.sensor import Effect, TypicalRange
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY, VOLTAGE
from gyrocal_ros.sim.sensors import stream
from gyrocal_ros.sim.strangers import STRANGERS

P_NONE, P_ONE, P_TWO = 0.2, 0.45, 0.15
"""Probabilities of hiding nothing, one and two effects of the library; otherwise one out of the library."""
SCALE_ERROR = 0.08
"""Largest error of the scale factor."""

_SPREADS = {'fan_speed.data': 3200.0, 'battery_state.current': 0.4, VOLTAGE: 0.065}
"""Standard deviations of the recorded signals while cleaning."""


def _ranges(effects: Sequence[Effect]) -> dict[str, tuple[TypicalRange, ...]]:
    """Return the typical ranges of the coefficients of those effects that have one for each."""
    found = {effect.name: tuple(item.typical for item in effect.coefficients) for effect in effects}
    return {name: tuple(filter(None, ranges)) for name, ranges in found.items() if all(ranges)}


LIBRARY_RANGES: dict[str, tuple[TypicalRange, ...]] = _ranges(SHIPPED) | _ranges(
    covariate_effects([Signal(name, 0.0, spread) for name, spread in _SPREADS.items()])
)
"""Every effect of the library that can be hidden, with the typical ranges of its coefficients."""

NOISES = {effect.name for effect in SHIPPED if is_noise(effect)}
DRAWN = [name for name in LIBRARY_RANGES if name not in NOISES]
"""Effects that are hidden where none is named; noise is no effect to find."""
OUT_OF_LIBRARY_RANGES: dict[str, tuple[TypicalRange, ...]] = _ranges(list(OUT_OF_LIBRARY.values()))
"""The same of effects that the library lacks."""
UNKNOWN_TO_THE_LIBRARY: dict[str, Effect] = {**OUT_OF_LIBRARY, **STRANGERS}
"""Effects that only the simulator knows."""
STRANGER_RANGES: dict[str, tuple[TypicalRange, ...]] = _ranges(list(STRANGERS.values()))
"""The same of laws to be learned; they are hidden only where they are named."""


@dataclass(frozen=True, slots=True)
class DrawnEffect:
    """An effect by name, and the values of its coefficients."""

    name: str
    values: tuple[float, ...]


def draw_hidden(seed: int, duration_s: float, names: Sequence[str] | None = None) -> tuple[DrawnEffect, ...]:
    """Draw the effects that a recording hides; sizes are log-uniform from just visible to large.

    Args:
        seed: seed of all draws.
        duration_s: length of the recording.
        names: names of the effects; None to draw nothing, one, two, or one out of the library.
    """
    rng = stream(seed, 'hidden')
    chosen = _draw_names(rng) if names is None else names
    return tuple(draw_values(name, rng, duration_s) for name in chosen)


def draw_values(
    name: str, rng: np.random.Generator, duration_s: float, size: float | None = None
) -> DrawnEffect:
    """Draw the coefficients of one effect.

    Args:
        name: name of the effect.
        rng: generator of signs, sizes and time constants.
        duration_s: length of the recording.
        size: 0, just visible, to 1, large; None to draw it.

    Raises:
        ConfigError: the effect has no typical ranges.
    """
    known = LIBRARY_RANGES | OUT_OF_LIBRARY_RANGES | STRANGER_RANGES
    if name not in known:
        raise ConfigError('has no sizes to draw from', where=name, todo=did_you_mean(name, known))
    drawn = rng.uniform(size=2)
    strength = drawn[0] if size is None else size
    values = [
        (rng.choice([-1.0, 1.0]) if item.signed else 1.0)
        * item.value(strength if item.is_strength else drawn[1])
        * (duration_s if item.of_duration else 1.0)
        for item in known[name]
    ]
    return DrawnEffect(name, tuple(map(float, values)))


def draw_scale_factor(seed: int) -> float:
    """Draw the true scale factor of a recording with hidden effects."""
    return 1.0 + float(stream(seed, 'hidden scale').uniform(-SCALE_ERROR, SCALE_ERROR))


def hide(drawn: Sequence[DrawnEffect], find: Callable[[str], Effect]) -> tuple[HiddenEffect, ...]:
    """Look up drawn effects by name, those of the library with `find`.

    Raises:
        ConfigError: an effect is not known, or has another number of coefficients.
    """
    return tuple(
        HiddenEffect(UNKNOWN_TO_THE_LIBRARY.get(item.name) or find(item.name), item.values) for item in drawn
    )


def _draw_names(rng: np.random.Generator) -> list[str]:
    chance = rng.uniform()
    if chance < P_NONE:
        return []
    if chance < P_NONE + P_ONE + P_TWO:
        count = 1 if chance < P_NONE + P_ONE else 2
        return [str(name) for name in rng.choice(DRAWN, count, replace=False)]
    return [str(rng.choice(list(OUT_OF_LIBRARY_RANGES)))]
