"""Figures of learned laws: a curve or response with its band, and the closed form that fits it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gyrocal_ros.diagnose.laws.closed_forms import ClosedForm, LearnedCurve, form_over
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, unit_of
from gyrocal_ros.effects.learned.curve import Curve
from gyrocal_ros.effects.learned.drives import ANY_TURN, LAST_REST, START
from gyrocal_ros.effects.learned.events import event_of
from gyrocal_ros.effects.learned.memory import ExponentialBank
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.laws import drive_in_words, form_in_words
from gyrocal_ros.report.plot import SIGMAS, VERMILLION, band, line, panels

LESS = '; what the scale factor and a constant bias explain is left out'


def law_sections(laws: Sequence[LearnedLaw]) -> Iterator[Section]:
    """Yield a figure for each learned curve and memory."""
    for number, law in enumerate(laws, start=1):
        if law.curve is None:
            continue
        forms = '. '.join(form_in_words(found) for found in law.forms)
        less = f'; closest in the library: {law.closest}' if law.closest else LESS
        caption = f'Learned {law.effect.name}, with three standard deviations{less}. Closed forms: {forms}.'
        best = law.forms[0] if law.forms else None
        yield Section(f'learned_{number}', curve_figure(law.curve, best), caption)


def curve_figure(curve: LearnedCurve, best: ClosedForm | None) -> Any:
    """Draw a curve over its signal, or a response over time, with its band, and the best closed form."""
    title, axis = _title_and_axis(curve.effect)
    of = curve.effect.of
    factor, unit = (1e2, '%') if of == 'scale' else (float(np.degrees(1.0)), 'deg/s')
    figure = panels(title, [f'{of} ({unit})'], 320)
    band(figure, curve.x, factor * curve.y, SIGMAS * factor * curve.std)
    line(figure, curve.x, factor * curve.y, 'learned', '.4g')
    if best is not None:
        drawn = factor * form_over(curve, best)
        line(figure, curve.x, drawn, best.form.name, '.4g', colour=VERMILLION, dash='dash')
    figure.update_xaxes(title_text=axis, hoverformat='.4g')
    return figure


def _title_and_axis(effect: Curve | ExponentialBank) -> tuple[str, str]:
    of, follows = effect.of, effect.follows
    if effect.over in ('signal', 'heading'):
        return f'The {of} as a function of {follows}', f'{follows} ({unit_of(follows)})'
    if effect.over == 'dynamics':
        return f'The {of} where a turn to 1 rad/s sets in', 'time (s)'
    if follows == START:
        return f'The {of} after the start', 'time (s)'
    if (event := event_of(follows)) is not None:
        return f'The {of} after {event.in_words}', 'time since it (s)'
    if follows == LAST_REST:
        return f'The {of} after a rest', 'time since its end (s)'
    if effect.over == 'fading':
        side = '' if follows == ANY_TURN else ' to the left'
        return f'The {of} after a turn{side}', 'time since its end (s)'
    return f'The {of} after a unit step of {drive_in_words(follows)}', 'time since the step (s)'
