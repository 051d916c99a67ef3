"""A learned curve or memory in its closed form: few coefficients in place of many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearMemoryEffect, column, recorded
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Curve, Of, curve
from gyrocal_ros.effects.learned.drives import (
    ABS_RATE,
    ANY_TURN,
    LAST_REST,
    START,
    derivatives,
    driven,
    lag,
    since_rest,
    since_turn,
)
from gyrocal_ros.effects.learned.events import event_of, since_event
from gyrocal_ros.effects.learned.forms import FORMS, Form, Over
from gyrocal_ros.effects.learned.memory import ExponentialBank, memory
from gyrocal_ros.effects.learned.memory_forms import FIRST_ORDER, MEMORY_FORMS, SECOND_ORDER
from gyrocal_ros.effects.learned.signals import RATE, values_of
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.sensor import Coefficient, Memory


@dataclass(frozen=True)
class Formula(LinearMemoryEffect):
    """`sum_j c_j g_j(x; p)` with the terms g of a closed form and its fixed parameter p."""

    name: str
    """That of the curve or memory."""
    coefficients: tuple[Coefficient, ...]
    form: str
    parameter: float = 0.0

    @property
    def about(self) -> Explanation:
        """Description for people."""
        learned = self.learned.about
        return Explanation(
            physics=f'A law of {self.learned.follows} with the closed form {self.form}, learned from a '
            'recording. It names no cause: look for the physics that has this form.',
            equation=f'w = w_n + sum_j c_j g_j(x){" w_n" if self.learned.of == "scale" else ""}, '
            f'g: {self.closed_form.equation}, p = {self.parameter:.4g}',
            usual_size='as found',
            best_motion=learned.best_motion,
            source=learned.source,
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against=learned.shown_against,
        )

    @property
    def learned(self) -> Curve | ExponentialBank:
        """The curve or memory that it takes the place of."""
        return _learned(self.name)

    @property
    def signal(self) -> str:
        """Name of the signal where a recording may lack it, else empty."""
        return self.learned.signal

    @property
    def closed_form(self) -> Form:
        """The closed form."""
        return _forms(self.learned.over)[self.form]

    @property
    def constants(self) -> tuple[float, ...]:
        """The fixed p; none for a form without."""
        return (self.parameter,) if self.parameter else ()

    @property
    def parameters(self) -> tuple[float, ...]:
        """The fixed p where it is a parameter of the form."""
        return self.constants if self.closed_form.is_scanned else ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of a change of each of `parameters` that changes the form."""
        return tuple(map(abs, self.parameters))

    def at(self, parameters: tuple[float, ...]) -> Formula:
        """Return the effect with other `parameters`."""
        return replace(self, parameter=parameters[0])

    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the terms (N, q), times the rate for a scale; zero where the signal is not recorded."""
        terms, memory = _TERMS[self.closed_form.over](self, block, memory)
        return terms * block.rate_rad_s[:, 2:] if self.learned.of == 'scale' else terms, memory


def formula(name: str, form: str, parameter: float = 0.0, where: str = '') -> Formula:
    """Make the closed form of a learned effect, with a prior of usual size.

    Args:
        name: name of a learned curve or memory, `bias_curve:rate`.
        form: name of a closed form of what it is a function of.
        parameter: its fixed parameter.
        where: place of the names, for the error message.

    Raises:
        ConfigError: the effect is none of these, or has no such form.
    """
    if not name.partition(':')[0].endswith(('_curve', '_memory')):
        raise ConfigError(f'{name} has no closed form', where=where, todo='leave out `form`')
    learned = _learned(name)
    known = _forms(learned.over)
    if form not in known:
        raise ConfigError(
            f'there is no form {form!r}', where=f'{where}, {name}', todo=did_you_mean(form, known)
        )
    units = units_of(learned.of, learned.follows, known[form])
    items = [
        Coefficient(f'c{number}', unit, TYPICAL[learned.of]) for number, unit in enumerate(units, start=1)
    ]
    return Formula(name, tuple(items), form, parameter)


def units_of(of: Of, follows: str, form: Form) -> tuple[str, ...]:
    """Return the units (q,) of the linear parameters of a form.

    Args:
        of: what follows.
        follows: name of the signal, or the drive of a memory.
        form: closed form.
    """
    if form.over == 'dynamics':
        return ('s', 's^2')[: len(form.terms)]
    is_by_rate = form.over == 'response' and follows in (RATE, ABS_RATE)
    return ('1' if is_by_rate and of == 'bias' else UNIT[of],) * len(form.terms)


@cache
def _learned(name: str) -> Curve | ExponentialBank:
    kind, _, follows = name.partition(':')
    of: Of = 'scale' if kind.startswith('scale') else 'bias'
    return curve(of, follows) if kind.endswith('curve') else memory(of, follows)


@cache
def _forms(over: Over) -> dict[str, Form]:
    return {form.name: form for form in (*FORMS, *MEMORY_FORMS) if form.over == over}


def _of_signal(effect: Formula, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    values = values_of(effect.learned.follows, block)
    return recorded(effect.closed_form.columns(values, effect.parameter)), None


def _fading(effect: Formula, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    follows = effect.learned.follows
    if follows == START:
        return effect.closed_form.columns(block.time_s, effect.parameter), None
    if event_of(follows) is not None:
        size, elapsed_s, now = since_event(follows, block, before)
    elif follows == LAST_REST:
        size, elapsed_s, now = since_rest(block, before)
    else:
        side, elapsed_s, now = since_turn(block, before)
        size = np.abs(side) if follows == ANY_TURN else side
    return size[:, None] * effect.closed_form.columns(elapsed_s, effect.parameter), now


def _dynamics(effect: Formula, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    *both, now = derivatives(block, before)
    return column(*both[: len(effect.coefficients)]), now


def _response(effect: Formula, block: MotionBlock, before: Memory) -> tuple[Array, Memory]:
    first, levels = before if before is not None else (None, (None, None))
    drive, first = driven(effect.learned.follows, block, first)
    once, level = lag(drive, block.dt_s, effect.parameter or np.inf, levels[0])
    twice, next_level = lag(once, block.dt_s, effect.parameter or np.inf, levels[1])
    responses = {FIRST_ORDER: once, SECOND_ORDER: twice, 'passing': drive - once}
    return column(responses.get(effect.form, drive)), (first, (level, next_level))


_TERMS: dict[str, Callable[[Formula, MotionBlock, Memory], tuple[Array, Memory]]] = {
    'signal': _of_signal,
    'heading': _of_signal,
    'fading': _fading,
    'dynamics': _dynamics,
    'response': _response,
}
