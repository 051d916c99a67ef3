"""Drawing lots: which effects a recording hides, and how strong they are.

All draws depend on the seed alone. The effects are named here, not imported: whoever draws also
looks the names up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.out_of_library import STRANGERS, VOLTAGE
from gyrocal_ros.sim.sensors import stream

_DEG = math.radians(1.0)
NONE, ONE, TWO = 0.2, 0.45, 0.15
"""Chances of hiding nothing, one and two effects of the library; else it is a stranger."""
SCALE_ERROR = 0.08
"""Largest error of the scale factor that is drawn."""


@dataclass(frozen=True, slots=True)
class Range:
    """Sizes of one coefficient."""

    visible: float
    """So large that it can just be seen in a recording of five minutes with mixed turns."""
    large: float
    signed: bool = True
    """Either sign may come up."""
    is_size: bool = True
    """How strong the effect is; else a time constant or the like, drawn by itself."""

    def value(self, size: float) -> float:
        """The value for a size of 0, just visible, to 1, large."""
        return self.visible * (self.large / self.visible) ** size


def _between(low: float, high: float) -> Range:
    return Range(low, high, signed=False, is_size=False)


_SPREADS = {'fan_speed.data': 3200.0, 'battery_state.current': 0.4, VOLTAGE: 0.065}
"""Standard deviations of the recorded signals while cleaning."""

RANGES: dict[str, tuple[Range, ...]] = {
    'scale_asymmetry': (Range(5e-4, 0.01),),
    'scale_quadratic': (Range(5e-4, 3e-3),),
    'scale_cubic': (Range(5e-4, 3.3e-3),),
    'bias_warmup': (Range(0.1 * _DEG, 2.0 * _DEG), _between(100.0, 600.0)),
    'bias_temperature': (Range(0.01 * _DEG, 0.05 * _DEG),),
    'scale_temperature': (Range(2e-4, 1e-3),),
    'g_sensitivity': (Range(0.05 * _DEG, 0.2 * _DEG), Range(0.08 * _DEG, 0.2 * _DEG)),
    'cross_axis': (Range(0.03, 0.05), Range(0.02, 0.05)),
    'gyro_lag': (Range(0.003, 0.06, signed=False),),
    'rate_saturation': (Range(85.0 * _DEG, 50.0 * _DEG, signed=False),),
    'rate_deadband': (Range(0.1 * _DEG, 0.5 * _DEG, signed=False),),
    'vibration_rectification': (Range(0.15 * _DEG, 1.5 * _DEG),),
    'turn_hysteresis': (Range(0.06 * _DEG, 1.0 * _DEG), _between(4.0, 40.0)),
    'camera_time_offset': (Range(0.003, 0.06),),
    'wheel_scale': (Range(0.02, 0.05),),
    'turn_slip': (Range(0.003, 0.04, signed=False),),
    'lateral_drift': (Range(0.007, 0.03), Range(0.007, 0.03)),
    'camera_tilt': (Range(0.3 * _DEG, 3.0 * _DEG), Range(0.3 * _DEG, 3.0 * _DEG)),
    'camera_position': (Range(0.004, 0.02), Range(0.004, 0.02)),
    'focal_length': (Range(0.015, 0.03),),
    'principal_point': (Range(1.0, 10.0), Range(1.0, 10.0)),
    'radial_distortion': (Range(0.004, 0.03), Range(0.001, 0.006)),
} | {
    f'covariate_{of}:{signal}': (Range(visible / spread, large / spread),)
    for of, visible, large in (('bias', 0.01 * _DEG, 0.2 * _DEG), ('scale', 5e-4, 0.01))
    for signal, spread in _SPREADS.items()
}
"""Every effect of the library that can be hidden, with the sizes of its coefficients."""

STRANGE_RANGES: dict[str, tuple[Range, ...]] = {
    'stranger_knock': (Range(0.05 * _DEG, 0.5 * _DEG), _between(0.25, 0.75)),  # parts of the recording
    'stranger_speed_bias': (Range(0.1 * _DEG, 2.0 * _DEG),),
    'stranger_supply_kink': (Range(0.03, 0.3), _between(16.07, 16.17)),
}


@dataclass(frozen=True, slots=True)
class Drawn:
    """An effect by name, and the values of its coefficients."""

    name: str
    values: tuple[float, ...]


def draw_hidden(seed: int, duration_s: float, names: Sequence[str] | None = None) -> tuple[Drawn, ...]:
    """Draw the effects that a recording hides, and their sizes, log-uniform from just visible to large.

    Args:
        seed: of all draws.
        duration_s: length of the recording.
        names: which effects; None to draw nothing, one, two, or a stranger to the library.
    """
    rng = stream(seed, 'hidden')
    chosen = _draw_names(rng) if names is None else names
    return tuple(draw_values(name, rng, duration_s) for name in chosen)


def draw_values(name: str, rng: np.random.Generator, duration_s: float, size: float | None = None) -> Drawn:
    """Draw the values of one effect.

    Args:
        name: of the effect.
        rng: where signs, sizes and time constants come from.
        duration_s: length of the recording.
        size: 0, just visible, to 1, large; None to draw it.

    Raises:
        ConfigError: there are no sizes for that effect.
    """
    drawn = rng.uniform(size=2)
    strength = drawn[0] if size is None else size
    values = [
        (rng.choice([-1.0, 1.0]) if item.signed else 1.0) * item.value(strength if item.is_size else drawn[1])
        for item in _ranges(name)
    ]
    return _in_time(name, values, duration_s)


def draw_scale_factor(seed: int) -> float:
    """Draw the true scale factor of a recording that hides something."""
    return 1.0 + float(stream(seed, 'hidden scale').uniform(-SCALE_ERROR, SCALE_ERROR))


def hide(drawn: Sequence[Drawn], find: Callable[[str], Effect]) -> tuple[HiddenEffect, ...]:
    """Look up what was drawn: strangers here, all others where the library is known.

    Raises:
        ConfigError: an effect is not known, or has another number of coefficients.
    """
    return tuple(HiddenEffect(STRANGERS.get(item.name) or find(item.name), item.values) for item in drawn)


def _draw_names(rng: np.random.Generator) -> list[str]:
    lot = rng.uniform()
    if lot < NONE:
        return []
    if lot < NONE + ONE + TWO:
        count = 1 if lot < NONE + ONE else 2
        return [str(name) for name in rng.choice(list(RANGES), count, replace=False)]
    return [str(rng.choice(list(STRANGE_RANGES)))]


def _ranges(name: str) -> tuple[Range, ...]:
    known = RANGES | STRANGE_RANGES
    if name not in known:
        raise ConfigError('has no sizes to draw from', where=name, todo=did_you_mean(name, list(known)))
    return known[name]


def _in_time(name: str, values: list[float], duration_s: float) -> Drawn:
    if name == 'stranger_knock':
        values[1] *= duration_s
    return Drawn(name, tuple(map(float, values)))
