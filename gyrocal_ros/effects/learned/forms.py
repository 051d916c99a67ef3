"""Closed forms of a function of one variable: what a learned curve may be written as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.learned.signals import RATE

Over: TypeAlias = Literal['signal', 'heading', 'response', 'fading', 'dynamics']
"""What a learned function is a function of: a signal; the heading; the time since its drive stepped up; the
time since a turn, a rest, an event or the start; the time since a turn sets in, see `start_of_turn`."""
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


def _middle(low: float, high: float) -> Array:
    """Return the one place that polynomials are about: far from it their terms are hardly separable."""
    return np.array([0.0 if low < 0.0 < high else 0.5 * (low + high)])


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
    """In x and p, the scanned parameter; a Python expression for each term, by commas. The dynamics have
    derivatives of the rate w."""
    terms: tuple[Term, ...]
    values: Values = _nothing
    is_about_zero: bool = False
    """True for a form that needs a range on both sides of zero."""
    over: Over = 'signal'
    not_of: tuple[str, ...] = ()
    """What may be followed where bias or scale factor have the form already, or make it another one."""

    chosen: int = 0
    """Number of parameters that the form sets equal to others."""

    @property
    def size(self) -> int:
        """Number of its parameters."""
        return len(self.terms) + self.is_scanned

    @property
    def is_scanned(self) -> bool:
        """True if p is a parameter of the form; not for one without, or one that is about a given place."""
        return self.values not in (_nothing, _middle)

    def columns(self, x: Array, p: float) -> Array:
        """Return the terms (n, q) at values (n,) of x."""
        return np.stack([term(x, p) for term in self.terms], axis=1)

    def suits(self, follows: str, low: float, high: float) -> bool:
        """Return True if the form is meant for what a function follows, and its range."""
        return follows not in self.not_of and (not self.is_about_zero or low < 0.0 < high)


FORMS: tuple[Form, ...] = (
    Form('line', 'x', (lambda x, p: x,)),
    Form('square', 'x**2', (lambda x, p: x**2,)),
    Form('cube', 'x**3', (lambda x, p: x**3,)),
    Form('absolute value', 'np.abs(x)', (lambda x, p: np.abs(x),), is_about_zero=True),
    Form('parabola', 'x - p, (x - p)**2', (lambda x, p: x - p, lambda x, p: (x - p) ** 2), _middle),
    Form('hinge', 'np.maximum(x - p, 0.0)', (lambda x, p: np.maximum(x - p, 0.0),), _inside, not_of=(RATE,)),
    # Of the rate, it is zero about rest: elsewhere bias and scale factor would not be those of slow turns.
    Form(
        'hinge away from zero',
        'np.sign(p) * np.maximum(np.sign(p) * x - np.abs(p), 0.0)',
        (lambda x, p: np.sign(p) * np.maximum(np.sign(p) * x - np.abs(p), 0.0),),
        _inside,
        is_about_zero=True,
    ),
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
        'saturation',
        'np.clip(x, -p, p)',
        (lambda x, p: np.clip(x, -p, p),),
        _from_zero,
        is_about_zero=True,
        not_of=(RATE,),
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
        over='heading',
    ),
    Form(
        'sine of twice the heading',
        'np.sin(2.0 * x), np.cos(2.0 * x)',
        (lambda x, p: np.sin(2.0 * x), lambda x, p: np.cos(2.0 * x)),
        over='heading',
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
        over='heading',
    ),
)
"""From simple to complex."""
