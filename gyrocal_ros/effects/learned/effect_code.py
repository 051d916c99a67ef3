"""The part of an effect's Python code that computes a closed form."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from gyrocal_ros.effects.learned.bump import Bump
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.effects.learned.drives import ANY_TURN, LAST_REST, START
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.formula import Formula
from gyrocal_ros.effects.learned.memory_forms import FIRST_ORDER, SECOND_ORDER
from gyrocal_ros.effects.learned.wave import ORDERS, Sine, Wave

Closed: TypeAlias = Formula | Bump | Sine | Wave
"""A law with few fixed parameters; of a wave, the period alone may have to change."""

CURVE_IMPORTS = """from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column, recorded
from gyrocal_ros.effects.learned.signals import values_of
from gyrocal_ros.model.sensor import Coefficient
"""
PLACE_IMPORTS = """from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient
"""
MEMORY_IMPORTS = """from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearMemoryEffect, column
from gyrocal_ros.effects.learned.{module} import {helpers}
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
AT_A_PLACE = '''    def columns(self, block: MotionBlock) -> Array:
        """Return the bump (N, 1), zero where no filter tells the position."""
        if block.position_m is None:
            return np.zeros((len(block.dt_s), 1))
        d = np.hypot(*(block.position_m - np.array(PLACE_M)).T)
        return column({term})
'''
REMEMBERED = '''    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the terms of the form (N, {count}), and what the next block has to know."""
'''
FADING = """        # {what} in s.
        {factor}, x, memory = {call}
        p = P
        terms = (
{terms}
        )
        return column(*({signed} * term for term in terms)), memory
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
PARAMETER = '''
P = {parameter!r}
"""The parameter in which the form is not linear; fixed as it was found."""
'''
PARAMETERS_OF_PLACE = '''
PLACE_M = {place_m!r}
WIDTH_M = {width_m!r}
"""The place in the map and the width, fixed as they were found."""
'''


@dataclass(frozen=True, slots=True)
class Code:
    """Parts of a file that depend on what the form is a function of."""

    imports: str
    base: str
    method: str
    x_is: str
    """What x is, for the equation."""
    terms: tuple[str, ...]
    """The terms of the form as Python expressions."""
    constants: str = ''


def code_of(effect: Closed) -> Code:
    """Return the code of a law in closed form."""
    if isinstance(effect, Bump):
        return _at_a_place(effect)
    if isinstance(effect, Formula):
        terms, signal = _split(effect.closed_form.equation), effect.learned.follows
        if effect.closed_form.over not in ('signal', 'heading') and signal != START:
            return _remembered(effect, terms)
        return _over('time' if signal == START else signal, effect.learned.of, terms, effect.constants)
    orders = ORDERS[:1] if isinstance(effect, Sine) else ORDERS
    terms = [
        f'np.{name}({2.0 * order!r} * np.pi * x / p)' for name in ('sin', 'cos') for order in orders.tolist()
    ]
    return _over('time', effect.of, terms, effect.parameters)


def _over(signal: str, of: Of, terms: Sequence[str], parameters: tuple[float, ...]) -> Code:
    """Return the code of a function of a signal."""
    method = CURVE.format(count=len(terms), follows=signal, terms=_listed(terms), rate=_rate(of))
    constants = _constant(method, parameters)
    return Code(CURVE_IMPORTS, 'LinearGyroEffect', method, f'x is {signal}', tuple(terms), constants)


def _at_a_place(effect: Bump) -> Code:
    term, x_is = 'np.exp(-0.5 * np.square(d / WIDTH_M))', 'd is the distance from the place'
    constants = PARAMETERS_OF_PLACE.format(place_m=effect.parameters[:2], width_m=effect.width_m)
    return Code(PLACE_IMPORTS, 'LinearGyroEffect', AT_A_PLACE.format(term=term), x_is, (term,), constants)


def _remembered(effect: Formula, terms: Sequence[str]) -> Code:
    """Return the code of a form with a memory."""
    form, follows = effect.closed_form, effect.learned.follows
    if form.over == 'fading':
        helpers, body, x_is = _fading(effect.learned.of, follows, terms)
    elif form.over == 'dynamics':
        helpers, body = (
            'derivatives',
            DYNAMICS.format(derivatives=', '.join(('first', 'second')[: len(terms)])),
        )
        x_is = 'w in the form is the reading'
    else:
        body = RESPONSES[form.name].format(follows=follows, rate=_rate(effect.learned.of))
        helpers = 'driven, lag' if 'lag(' in body else 'driven'
        x_is = f'x is the time after a unit step of {follows}'
    method = REMEMBERED.format(count=len(terms)) + body
    imports = MEMORY_IMPORTS.format(module='events' if event_of(follows) else 'drives', helpers=helpers)
    constants = _constant(method, effect.constants)
    return Code(imports, 'LinearMemoryEffect', method, x_is, tuple(terms), constants)


def _fading(of: Of, follows: str, terms: Sequence[str]) -> tuple[str, str, str]:
    """Return the helper, the code and the meaning of x of what fades after a turn, a rest or an event."""
    helper, factor, since, named = 'since_turn', 'side', 'the last turn', ''
    what = 'The side of the last turn, and the time since its end'
    if (event := event_of(follows)) is not None:
        helper, factor, since, named = 'since_event', 'happened', event.in_words, f'{follows!r}, '
        what = '1 after the first event, else 0, and the time since the last one'
    elif follows == LAST_REST:
        helper, factor, since = 'since_rest', 'drives', 'the last rest'
        what = '1 where the robot drives after a rest, else 0, and the time since its end'
    call = f'{helper}({named}block, memory)'
    signed = _rate(of) + ('abs(side)' if follows == ANY_TURN else factor)
    body = FADING.format(terms=_listed(terms), what=what, factor=factor, call=call, signed=signed)
    return helper, body, f'x is the time since {since}'


def _constant(method: str, parameters: tuple[float, ...]) -> str:
    """Return the constant P if the method has it."""
    return PARAMETER.format(parameter=(*parameters, 0.0)[0]) if re.search(r'\bP\b', method) else ''


def _listed(terms: Sequence[str]) -> str:
    return '\n'.join(f'            {term},' for term in terms)


def _rate(of: Of) -> str:
    return 'block.rate_rad_s[:, 2] * ' if of == 'scale' else ''


def _split(equation: str) -> list[str]:
    """Split an equation at the commas outside of brackets."""
    terms, depth = [''], 0
    for letter in equation:
        depth += (letter == '(') - (letter == ')')
        if letter == ',' and depth == 0:
            terms.append('')
        else:
            terms[-1] += letter
    return [term.strip() for term in terms]
