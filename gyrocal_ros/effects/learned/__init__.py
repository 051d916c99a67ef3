"""Effects whose law is learned from a recording: curves, maps, memories, steps and waves, stored as data.

Each is a sum of fixed functions; their coefficients are estimated by the filter like those of any effect. The
prior standard deviations of the coefficients make the sum smooth. A `formula` is a curve or a memory in its
closed form, a `Bump` that of a map, a `Sine` that of a wave.
"""

from __future__ import annotations

from collections.abc import Callable

from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.learned.bump import BUMP, Bump
from gyrocal_ros.effects.learned.curve import curve
from gyrocal_ros.effects.learned.formula import formula
from gyrocal_ros.effects.learned.memory import memory
from gyrocal_ros.effects.learned.place_map import place_map
from gyrocal_ros.effects.learned.step import step
from gyrocal_ros.effects.learned.wave import SINE, sine_of, wave

LEARNED_EFFECTS: dict[str, Callable[[str], LibraryEffect]] = {
    'bias_curve': lambda signal: curve('bias', signal),
    'scale_curve': lambda signal: curve('scale', signal),
    'bias_memory': lambda drive: memory('bias', drive),
    'scale_memory': lambda drive: memory('scale', drive),
    'bias_map': lambda signal: place_map(signal),
    'bias_step': lambda signal: step('bias', signal),
    'scale_step': lambda signal: step('scale', signal),
    'bias_wave': lambda signal: wave('bias', signal),
    'scale_wave': lambda signal: wave('scale', signal),
}
"""Effects whose names contain what they follow, `bias_curve:rate`."""


def in_closed_form(name: str, form: str, where: str) -> LibraryEffect:
    """Return a learned effect in a closed form, with parameters of usual size.

    Args:
        name: name of the learned effect.
        form: name of the closed form.
        where: place of the names, for the error message.

    Raises:
        ConfigError: the effect has no such form.
    """
    if (name, form) == (Bump().name, BUMP):
        return Bump()
    if form == SINE and name.partition(':')[0].endswith('_wave'):
        return sine_of(name)
    return formula(name, form, where=where)


__all__ = ['LEARNED_EFFECTS', 'curve', 'formula', 'in_closed_form', 'memory', 'place_map', 'step', 'wave']
