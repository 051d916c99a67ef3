"""Closed forms of a function of one signal: what a learned curve may be written as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.learned.signals import HEADING

Term: TypeAlias = Callable[[Array, float], Array]
"""A function of the signal (n,) and of the scanned parameter p."""
Values: TypeAlias = Callable[[float, float], Array]
"""Values of the scanned parameter to try, for a range of the signal."""
KINKS = 41
"""Number of places within the range that are tried for a kink or a jump."""
PERIODS = np.arange(0.25, 6.01, 0.125)
"""Numbers of periods over the range that are tried for a sine."""
DECAYS = np.geomspace(0.05, 2.0, 25)
"""Lengths of an exponential, as parts of the range."""


def _nothing(low: float, high: float) -> Array:
    return np.zeros(1)


def _inside(low: float, high: float) -> Array:
    return np.linspace(low, high, KINKS)[2:-2]


def _from_zero(low: float, high: float) -> Array:
    return max(-low, high) * np.linspace(0.05, 0.9, KINKS)


def _lengths(low: float, high: float) -> Array:
    return (high - low) * DECAYS


@dataclass(frozen=True, slots=True)
class Form:
    """A family of functions, linear in all parameters but one."""

    name: str
    equation: str
    """In x, the signal, and p, the scanned parameter; a Python expression for each term, by commas."""
    terms: tuple[Term, ...]
    values: Values = _nothing
    is_about_zero: bool = False
    """True for a form that needs a range on both sides of zero."""
    of_heading: bool = False
    """True for the forms of a heading, which has no others."""

    @property
    def size(self) -> int:
        """Number of its parameters."""
        return len(self.terms) + (self.values is not _nothing)

    def columns(self, x: Array, p: float) -> Array:
        """Return the terms (n, q) at values (n,) of the signal."""
        return np.stack([term(x, p) for term in self.terms], axis=1)

    def suits(self, signal: str, low: float, high: float) -> bool:
        """Return True if the form is meant for the signal and its range."""
        return self.of_heading == (signal == HEADING) and (not self.is_about_zero or low < 0.0 < high)


FORMS: tuple[Form, ...] = (
    Form('line', 'x', (lambda x, p: x,)),
    Form('square', 'x**2', (lambda x, p: x**2,)),
    Form('cube', 'x**3', (lambda x, p: x**3,)),
    Form('absolute value', 'np.abs(x)', (lambda x, p: np.abs(x),), is_about_zero=True),
    Form('parabola', 'x, x**2', (lambda x, p: x, lambda x, p: x**2)),
    Form('hinge', 'np.maximum(x - p, 0.0)', (lambda x, p: np.maximum(x - p, 0.0),), _inside),
    Form(
        'line with a kink',
        'x, np.maximum(x - p, 0.0)',
        (lambda x, p: x, lambda x, p: np.maximum(x - p, 0.0)),
        _inside,
    ),
    Form('step', 'np.heaviside(x - p, 0.0)', (lambda x, p: np.heaviside(x - p, 0.0),), _inside),
    Form(
        'dead band',
        'np.sign(x) * np.maximum(np.abs(x) - p, 0.0)',
        (lambda x, p: np.sign(x) * np.maximum(np.abs(x) - p, 0.0),),
        _from_zero,
        is_about_zero=True,
    ),
    Form(
        'even dead band',
        'np.maximum(np.abs(x) - p, 0.0)',
        (lambda x, p: np.maximum(np.abs(x) - p, 0.0),),
        _from_zero,
        is_about_zero=True,
    ),
    Form(
        'sine',
        'np.sin(2.0 * np.pi * x / p), np.cos(2.0 * np.pi * x / p)',
        (lambda x, p: np.sin(2.0 * np.pi * x / p), lambda x, p: np.cos(2.0 * np.pi * x / p)),
        lambda low, high: (high - low) / PERIODS,
    ),
    Form('falling exponential', 'np.exp(-x / p)', (lambda x, p: np.exp(-x / p),), _lengths),
    Form('rising exponential', 'np.exp(x / p)', (lambda x, p: np.exp(x / p),), _lengths),
    Form(
        'sine of the heading',
        'np.sin(x), np.cos(x)',
        (lambda x, p: np.sin(x), lambda x, p: np.cos(x)),
        of_heading=True,
    ),
    Form(
        'sine of twice the heading',
        'np.sin(2.0 * x), np.cos(2.0 * x)',
        (lambda x, p: np.sin(2.0 * x), lambda x, p: np.cos(2.0 * x)),
        of_heading=True,
    ),
    Form(
        'sines of the heading and of twice it',
        'np.sin(x), np.cos(x), np.sin(2.0 * x), np.cos(2.0 * x)',
        (
            lambda x, p: np.sin(x),
            lambda x, p: np.cos(x),
            lambda x, p: np.sin(2.0 * x),
            lambda x, p: np.cos(2.0 * x),
        ),
        of_heading=True,
    ),
)
"""From simple to complex."""

_LIBRARY = {
    ('bias', 'rate', 'square'): 'scale_quadratic',
    ('bias', 'rate', 'cube'): 'scale_cubic',
    ('bias', 'rate', 'absolute value'): 'scale_asymmetry',
    ('bias', 'temperature', 'line'): 'bias_temperature',
    ('scale', 'temperature', 'line'): 'scale_temperature',
    ('bias', 'yaw_acceleration', 'line'): 'gyro_lag',
    ('bias', 'force_x', 'line'): 'g_sensitivity',
    ('bias', 'force_y', 'line'): 'g_sensitivity',
    ('bias', 'vibration', 'line'): 'vibration_rectification',
}
_MEANINGS = {
    'rate': 'nonlinearity of the scale factor',
    'heading': 'a field fixed in the room, such as magnetism, that the sensor feels',
    'force_x': 'sensitivity to acceleration',
    'force_y': 'sensitivity to acceleration',
    'force_z': 'sensitivity to acceleration',
    'yaw_acceleration': 'sensitivity to angular acceleration, or a lag',
    'vibration': 'rectified vibration',
    'temperature': 'temperature dependence',
}


def library_effect(of: str, signal: str, form: str) -> str:
    """Return the effect of the library that has this form; empty without one."""
    if (of, signal, form) in _LIBRARY:
        return _LIBRARY[of, signal, form]
    return f'covariate_{of}:{signal}' if form == 'line' and signal not in _MEANINGS else ''


def meaning(signal: str) -> str:
    """Return what a dependence on a signal usually means, in a few words."""
    return _MEANINGS.get(signal, f'something that goes with {signal} disturbs the sensor')
