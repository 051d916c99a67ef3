"""The axis of a learned law, and its curve and closed forms there before it is added to the model."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.shapes import HEADING, RATE, TEMPERATURE_C, TIME
from gyrocal_ros.diagnose.laws.closed_forms import form_over
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw
from gyrocal_ros.diagnose.series.error_curves import ErrorCurve, curve_by_effects
from gyrocal_ros.effects.learned import signals
from gyrocal_ros.effects.learned.drives import START
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.recording import TEMPERATURE

MAX_FORMS = 2
"""Number of closed forms that are drawn beside a learned curve."""
_DEG = math.degrees(1.0)
_AXES = {
    signals.RATE: (RATE, _DEG),
    signals.HEADING: (HEADING, _DEG),
    TEMPERATURE: (TEMPERATURE_C, 1.0),
    'time': (TIME, 1.0),
    START: (TIME, 1.0),
}
"""Axis of an error curve, and its unit per unit of the signal, for what a law follows."""


def law_axis(law: LearnedLaw) -> tuple[str, bool]:
    """Return the signal of the error curve that shows a law, and True if the law is of the scale.

    There is no such curve for a law that follows no single recorded signal, such as a map.
    """
    return _AXES.get(law.follows, (law.follows, 1.0))[0], law.kind.startswith('scale')


def curves_of_law(
    law: LearnedLaw, run: Run, signal: str, of_scale: bool, like: ErrorCurve
) -> Iterator[tuple[str, ErrorCurve]]:
    """Yield name and error that a law would explain over a signal, less what the error curve is less.

    A curve over its own signal has its uncertainty, and its closed forms follow. Any other law is expressed
    as a function of the signal.

    Args:
        law: the law.
        run: run of the model with the law as its last effect.
        signal: name of the signal.
        of_scale: True for an error of the scale.
        like: error curve over that signal, without the law.
    """
    if law.curve is None or not law.is_over_a_signal or law_axis(law) != (signal, of_scale):
        drawn = curve_by_effects(run, 1, signal, like, of_scale)
        if drawn is not None:
            yield f'by {law.effect.name}, if added', drawn
        return
    x = _AXES.get(law.follows, ('', 1.0))[1] * law.curve.x
    y = law.curve.y
    curve = ErrorCurve(x, y - _level(y, x, signal, like), law.curve.std)
    yield f'by {law.effect.name}, if added', curve
    for found in law.forms[:MAX_FORMS]:
        y = form_over(law.curve, found)
        level = _level(y, x, signal, like)
        yield f'{found.form.name} ({_verdict(found.fits)})', ErrorCurve(x, y - level, np.zeros(len(x)))


def _verdict(fits: bool) -> str:
    return 'closed form that fits' if fits else 'does not fit'


def _level(y: Array, x: Array, signal: str, like: ErrorCurve) -> Array:
    """Return the mean over the knots, by the rate a straight line, of a function y (n,) of x (n,)."""
    order = 1 if signal == RATE else 0
    level: Array = np.polyval(np.polyfit(like.knots, np.interp(like.knots, x, y), order), x)
    return level
