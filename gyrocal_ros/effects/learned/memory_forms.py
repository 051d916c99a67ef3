"""Closed forms of a memory: what the response of a learned one may be written as."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.learned.drives import ANY_TURN, LAST_REST, START, start_of_turn
from gyrocal_ros.effects.learned.forms import Form
from gyrocal_ros.effects.learned.signals import RATE

FIRST_ORDER, SECOND_ORDER = 'first-order lag', 'second-order lag'
TIMES = np.geomspace(0.005, 1.0, 41)
"""Time constants that are tried, as parts of the time that a response is known for."""


def _times(low: float, high: float) -> Array:
    return high * TIMES


MEMORY_FORMS: tuple[Form, ...] = (
    Form('at once', '1.0', (lambda x, p: np.ones_like(x),), over='response', not_of=(RATE,)),
    Form(FIRST_ORDER, '1.0 - np.exp(-x / p)', (lambda x, p: -np.expm1(-x / p),), _times, over='response'),
    Form(
        SECOND_ORDER,
        '1.0 - (1.0 + x / p) * np.exp(-x / p)',
        (lambda x, p: 1.0 - (1.0 + x / p) * np.exp(-x / p),),
        _times,
        over='response',
        chosen=1,
    ),
    Form(
        'passing',
        'np.exp(-x / p)',
        (lambda x, p: np.exp(-x / p),),
        _times,
        over='response',
        not_of=(RATE,),
    ),
    Form(
        'lasting', '1.0', (lambda x, p: np.ones_like(x),), over='fading', not_of=(START, ANY_TURN, LAST_REST)
    ),
    Form('fading exponential', 'np.exp(-x / p)', (lambda x, p: np.exp(-x / p),), _times, over='fading'),
    Form(
        'fading of the second order',
        '(1.0 + x / p) * np.exp(-x / p)',
        (lambda x, p: (1.0 + x / p) * np.exp(-x / p),),
        _times,
        over='fading',
        chosen=1,
    ),
    Form(
        'fading hyperbola', '1.0 / (1.0 + x / p)', (lambda x, p: 1.0 / (1.0 + x / p),), _times, over='fading'
    ),
    Form(FIRST_ORDER, 'dw/dt', (lambda x, p: start_of_turn(x, 1),), over='dynamics'),
    Form(
        SECOND_ORDER,
        'dw/dt, d2w/dt2',
        (lambda x, p: start_of_turn(x, 1), lambda x, p: start_of_turn(x, 2)),
        over='dynamics',
    ),
)
"""From simple to complex. Two critically damped lags in a row are a second-order lag: two time constants that
are not many times apart cannot be distinguished from two equal ones."""


def physical(form: Form, values: Sequence[float]) -> str:
    """Return what the parameters of a form of the dynamics are; empty for any other form.

    The sensor reads w with `w'' / W^2 + 2 D w' / W + w = true rate`, or `T w' + w = true rate`.
    """
    if form.over != 'dynamics':
        return ''
    if form.name == FIRST_ORDER:
        return f'lag of {values[0]:.3g} s'
    slope, curvature = values
    if curvature <= 0.0:
        return 'form that no oscillator has'
    damping = 0.5 * slope / math.sqrt(curvature)
    if damping < 1.0:
        return (
            f'resonance with a period of {2.0 * math.pi * math.sqrt(curvature):.3g} s, damping {damping:.2g}'
        )
    root = math.sqrt(0.25 * slope**2 - curvature)
    return f'pair of lags of {0.5 * slope + root:.3g} s and {0.5 * slope - root:.3g} s'
