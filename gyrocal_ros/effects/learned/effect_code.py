"""The part of an effect's Python code that computes a closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.effects.learned.drives import START
from gyrocal_ros.effects.learned.forms import Form
from gyrocal_ros.effects.learned.formula import units_of
from gyrocal_ros.effects.learned.memory_forms import FIRST_ORDER, SECOND_ORDER

CURVE_IMPORTS = """from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column, recorded
from gyrocal_ros.effects.learned.signals import values_of
from gyrocal_ros.model.sensor import Coefficient
"""
MEMORY_IMPORTS = """from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearMemoryEffect, column
from gyrocal_ros.effects.learned.drives import {helpers}
from gyrocal_ros.model.sensor import Coefficient, Memory
"""
CURVE = '''    def columns(self, block: MotionBlock) -> Array:
        """Return the terms of the form (N, {count}), zero where the signal is not recorded."""
        x, p = values_of({follows!r}, block), P
        terms = (
{terms}
        )
        return column(*(recorded({rate}term) for term in terms))
'''
REMEMBERED = '''    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the terms of the form (N, {count}), and what the next block has to know."""
'''
FADING = """        # The side of the last turn, and the time since its end in s.
        side, x, memory = since_turn(block, memory)
        p = P
        terms = (
{terms}
        )
        return column(*(side * term for term in terms)), memory
"""
DYNAMICS = """        first, second, memory = derivatives(block, memory)
        return column({derivatives}), memory
"""
AT_ONCE = """        drive, memory = driven({follows!r}, block, memory)
        return column({rate}drive), memory
"""
LAG = """        # A signal counts from its first value.
        first, level = memory if memory is not None else (None, None)
        drive, first = driven({follows!r}, block, first)
        lagged, level = lag(drive, block.dt_s, P, level)
        return column({rate}lagged), (first, level)
"""
PASSING = LAG.replace('        return', '        passing = drive - lagged\n        return').replace(
    '}lagged', '}passing'
)
TWO_LAGS = """        # A signal counts from its first value; one lag drives the next.
        first, level, next_level = memory if memory is not None else (None, None, None)
        drive, first = driven({follows!r}, block, first)
        once, level = lag(drive, block.dt_s, P, level)
        twice, next_level = lag(once, block.dt_s, P, next_level)
        return column({rate}twice), (first, level, next_level)
"""
RESPONSES = {
    'at once': AT_ONCE,
    FIRST_ORDER: LAG,
    SECOND_ORDER: TWO_LAGS,
    'passing': PASSING,
}


@dataclass(frozen=True, slots=True)
class Code:
    """Parts of a file that depend on what the form is a function of."""

    imports: str
    base: str
    method: str
    x_is: str
    """What x is, for the equation."""
    units: tuple[str, ...]
    """Unit of each coefficient."""


def code_of(of: Of, follows: str, form: Form, terms: Sequence[str]) -> Code:
    """Return the code of a form.

    Args:
        of: what follows.
        follows: name of the signal, or the drive of a memory.
        form: closed form.
        terms: its terms as Python expressions in x and p.
    """
    listed = '\n'.join(f'            {term},' for term in terms)
    count, units = len(terms), units_of(of, follows, form)
    rate = 'block.rate_rad_s[:, 2] * ' if of == 'scale' else ''
    if form.over in ('signal', 'heading') or follows == START:
        signal = 'time' if follows == START else follows
        method = CURVE.format(count=count, follows=signal, terms=listed, rate=rate)
        return Code(CURVE_IMPORTS, 'LinearGyroEffect', method, f'x is {signal}', units)
    if form.over == 'fading':
        helpers, body = 'since_turn', FADING.format(terms=listed)
        x_is = 'x is the time since the last turn'
    elif form.over == 'dynamics':
        helpers, body = 'derivatives', DYNAMICS.format(derivatives=', '.join(('first', 'second')[:count]))
        x_is = 'w in the form is the reading'
    else:
        body = RESPONSES[form.name].format(follows=follows, rate=rate)
        helpers = 'driven, lag' if 'lag(' in body else 'driven'
        x_is = f'x is the time after a unit step of {follows}'
    method = REMEMBERED.format(count=count) + body
    return Code(MEMORY_IMPORTS.format(helpers=helpers), 'LinearMemoryEffect', method, x_is, units)
