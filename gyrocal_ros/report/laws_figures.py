"""Figures of learned laws: a curve with its band, and the closed form that fits it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gyrocal_ros.diagnose.closed_forms import ClosedForm, LearnedCurve, form_over
from gyrocal_ros.diagnose.learned_laws import LearnedLaw, unit_of
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.laws import form_in_words
from gyrocal_ros.report.plot import SIGMAS, VERMILLION, band, line, panels


def law_sections(laws: Sequence[LearnedLaw]) -> Iterator[Section]:
    """Yield a figure for each learned curve."""
    for number, law in enumerate(laws, start=1):
        if law.curve is None:
            continue
        forms = '. '.join(form_in_words(found) for found in law.forms)
        caption = (
            f'Learned {law.effect.name}, with three standard deviations; what the scale factor and a '
            f'constant bias explain is left out. Closed forms: {forms}.'
        )
        best = law.forms[0] if law.forms else None
        yield Section(f'learned_{number}', curve_figure(law.curve, best), caption)


def curve_figure(curve: LearnedCurve, best: ClosedForm | None) -> Any:
    """Draw a curve over its signal with its band, and the best closed form."""
    follows, of = curve.effect.follows, curve.effect.of
    factor, unit = (1e2, '%') if of == 'scale' else (float(np.degrees(1.0)), 'deg/s')
    figure = panels(f'The {of} as a function of {follows}', [f'{of} ({unit})'], 320)
    band(figure, curve.x, factor * curve.y, SIGMAS * factor * curve.std)
    line(figure, curve.x, factor * curve.y, 'learned', '.4g')
    if best is not None:
        drawn = factor * form_over(curve, best)
        line(figure, curve.x, drawn, best.form.name, '.4g', colour=VERMILLION, dash='dash')
    figure.update_xaxes(title_text=f'{follows} ({unit_of(follows)})', hoverformat='.4g')
    return figure
