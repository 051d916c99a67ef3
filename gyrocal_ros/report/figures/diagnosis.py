"""The figures of a diagnosis: where the model fails, what explains it, what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import BlindDrift
from gyrocal_ros.diagnose.regimes import Failure
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.report.diagnosis_series import Bend, CandidateRow, EffectCurve, Wander
from gyrocal_ros.report.figures.drawing import (
    AFTER,
    BEFORE,
    BLUE,
    CLEAR,
    GREEN,
    GREY,
    LOOKS,
    PURPLE,
    SIGMAS,
    VERMILLION,
    band,
    dress,
    kept,
    line,
    panels,
    points,
    show,
)

LEAST_GAIN = 0.3
"""What gains less log-likelihood is not worth a bar."""
SHADE, DARKNESS = 'rgba(213,94,0,0.13)', 'rgba(128,128,128,0.3)'
ROLES = {
    'best': ('explains most', GREEN, GREEN, ''),
    'found': ('missing, by this diagnosis', GREEN, GREEN, ''),
    'twin': ('cannot be told from it here', PURPLE, PURPLE, '/'),
    'significant': ('significant, as long as it is missing', BLUE, BLUE, '.'),
    'chance': ('no more than chance', CLEAR, GREY, ''),
}


def where_it_fails(
    title: str,
    wanders: Mapping[str, Wander],
    time_s: Array,
    rate_deg_s: Array,
    stretches: Sequence[Failure] = (),
    jump_s: float | None = None,
    camera_off: Sequence[tuple[float, float]] = (),
    drift: BlindDrift | None = None,
) -> go.Figure:
    """How the heading by the gyro runs away from the one that was seen, and while doing what.

    Args:
        title: of the figure.
        wanders: by name of the model; the band is that of the last one.
        time_s: (s,)
        rate_deg_s: (s,) turning rate.
        stretches: of time in which the model is off by more than chance, worst first.
        jump_s: when the bias jumped, where it did.
        camera_off: stretches of time in which the camera saw nothing.
        drift: without the camera, to mark the span in which it is worst.
    """
    titles = ['gyro less seen<br>(deg)', 'gained in 10 s<br>(deg)', 'turning rate<br>(deg/s)']
    figure = panels(title, titles, 200)
    last = list(wanders.values())[-1]
    reach = SIGMAS * np.degrees(last.std_rad)
    band(figure, last.time_s, np.zeros(len(reach)), reach, (1, 1), 'what noise explains (3 sigma)')
    for place, (name, wander) in enumerate(wanders.items()):
        look = LOOKS[place % len(LOOKS)]
        error = np.degrees(wander.error_rad)
        line(figure, wander.time_s, error, name, '.3f', (1, 1), look.colour, look.dash)
        gained, reach = np.degrees(wander.gained_rad), SIGMAS * np.degrees(wander.gained_std_rad)
        points(figure, wander.gained_s, gained, reach, name, '.3f', (2, 1), look)
    rows = kept(rate_deg_s)
    line(figure, time_s[rows], rate_deg_s[rows], 'turning rate', '.1f', (3, 1), GREY)
    figure.data[-1].showlegend = False
    for from_s, to_s in camera_off:
        figure.add_vrect(from_s, to_s, fillcolor=DARKNESS, line_width=0, row='all', col=1)
        _note(figure, 0.5 * (from_s + to_s), 'camera off', GREY, y=0.0, yanchor='bottom')
    if drift is not None and len(drift.error_rad):
        _worst_span(figure, drift)
    for rank, stretch in enumerate(stretches, start=1):
        figure.add_vrect(stretch.from_s, stretch.to_s, fillcolor=SHADE, line_width=0, row='all', col=1)
        middle_s = 0.5 * ((stretch.from_s or 0.0) + (stretch.to_s or 0.0))
        _note(figure, middle_s, f'<b>{rank}</b>', VERMILLION, y=1.0, yanchor='top')
    if jump_s is not None:
        figure.add_vline(jump_s, row='all', col=1, line={'color': PURPLE, 'width': 2, 'dash': 'dash'})
        words = f'the bias jumped at {jump_s:.0f} s '
        _note(figure, jump_s, words, PURPLE, y=0.0, yanchor='bottom', xanchor='right')
    figure.update_xaxes(range=[0.0, float(time_s[-1])])
    return figure


def _worst_span(figure: go.Figure, drift: BlindDrift) -> None:
    """A bracket below the span without the camera in which the heading drifts most."""
    worst = int(np.argmax(np.abs(drift.error_rad)))
    ends_s = drift.start_s[worst] + np.array([0.0, drift.span_s])
    figure.add_shape(
        type='line',
        x0=float(ends_s[0]),
        x1=float(ends_s[1]),
        y0=0.03,
        y1=0.03,
        yref='y domain',
        line={'color': PURPLE, 'width': 4},
        row=1,
        col=1,
    )
    error_deg = abs(float(np.degrees(drift.error_rad[worst])))
    words = f'worst without camera: {error_deg:.2f} deg'
    _note(figure, float(ends_s.mean()), words, PURPLE, y=0.05, yanchor='bottom')


def scores(table: Sequence[CandidateRow]) -> go.Figure:
    """What every candidate would explain, and how far beyond chance that is."""
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    dress(figure, 'What would explain it', 150 + 36 * len(table))
    names = [row.name.replace(':', ':<br>') for row in table]
    for role, (label, fill, edge, pattern) in ROLES.items():
        chosen = [place for place, row in enumerate(table) if row.role == role]
        for column, values in enumerate(([row.gain for row in table], [row.sigma for row in table]), start=1):
            figure.add_bar(
                x=[max(values[place], 0.0) for place in chosen],
                y=[names[place] for place in chosen],
                name=label,
                legendgroup=role,
                showlegend=column == 1 and bool(chosen),
                orientation='h',
                marker={
                    'color': fill,
                    'line': {'color': edge, 'width': 1.5},
                    'pattern': {'shape': pattern, 'fillmode': 'overlay', 'fgcolor': '#ffffff', 'size': 7},
                },
                hovertemplate='%{x:.1f}',
                row=1,
                col=column,
            )
    left = [place for place, row in enumerate(table) if np.isfinite(row.sigma_left)]
    if any(row.role == 'found' for row in table):
        figure.add_scatter(
            x=[table[place].sigma_left for place in left],
            y=[names[place] for place in left],
            name='once the missing is in the model',
            mode='markers',
            marker={
                'symbol': 'diamond',
                'size': 8,
                'color': '#ffffff',
                'line': {'color': VERMILLION, 'width': 2},
            },
            hovertemplate='%{x:.1f}',
            row=1,
            col=2,
        )
    limit = {'text': f'chance ends at {DEFAULT_SETTINGS.significant_sigma:g}', 'yanchor': 'bottom'}
    figure.add_vline(
        DEFAULT_SETTINGS.significant_sigma,
        row=1,
        col=2,
        line={'color': GREY, 'dash': 'dash'},
        annotation=limit,
        annotation_position='bottom right',
    )
    most = max([row.gain for row in table] + [10.0])
    bounds = [np.log10(LEAST_GAIN), np.log10(2.0 * most)]
    figure.update_xaxes(
        type='log', dtick=1, range=bounds, title_text='log-likelihood gained (log scale)', col=1
    )
    most = max([row.sigma for row in table] + [2.0 * DEFAULT_SETTINGS.significant_sigma])
    figure.update_xaxes(range=[0.0, 1.05 * most], title_text='sigma: how far beyond chance', col=2)
    figure.update_yaxes(categoryorder='array', categoryarray=names[::-1], showgrid=False)
    figure.update_layout(barmode='overlay', bargap=0.35)
    return figure


def contribution(name: str, drawn: EffectCurve) -> go.Figure:
    """What a found effect does, with its doubt."""
    figure = panels(f'What {name} does', [drawn.y_label], 300)
    rows = kept(drawn.y, drawn.std)
    band(figure, drawn.x[rows], drawn.y[rows], SIGMAS * drawn.std[rows], (1, 1))
    line(figure, drawn.x[rows], drawn.y[rows], 'as found', '.4g', (1, 1), GREEN)
    figure.update_xaxes(title_text=drawn.x_label, hoverformat='.4g')
    return figure


def bend(asked: Bend, names: tuple[str, str]) -> go.Figure:
    """The error of the bias or the scale as a function of what was recorded, before and after.

    Args:
        asked: what was asked of the recording.
        names: of the model before and after.
    """
    kind, unit = ('scale', '%') if asked.of_scale else ('bias', 'deg/s')
    size = 100.0 if asked.of_scale else np.degrees(1.0)
    figure = panels(f'{kind.capitalize()} by {asked.signal}', [f'error of the {kind} ({unit})'], 190)
    ranges = []
    for name, curve, look in zip(names, (asked.before, asked.after), (BEFORE, AFTER), strict=True):
        if curve is not None:
            value, reach = size * curve.values, SIGMAS * size * curve.stds
            points(figure, curve.knots, value, reach, name, '.3g', (1, 1), look, joined=True)
            ranges += [value, value + 0.6 * reach, value - 0.6 * reach]
    if asked.predicted is not None:
        value = size * asked.predicted.values
        line(figure, asked.predicted.knots, value, 'by the effects added', '.3g', (1, 1), BLUE, 'dash')
        ranges.append(value)
    figure.add_hline(0.0, line={'color': GREY, 'width': 1})
    figure.update_xaxes(title_text=asked.signal, hoverformat='.4g')
    show(figure, (1, 1), np.concatenate(ranges), margin=0.1)
    return figure


def _note(figure: go.Figure, x: float, words: str, colour: str, **place: Any) -> None:
    """Words in the first panel."""
    font = {'color': colour, 'size': 14}
    figure.add_annotation(x=x, yref='y domain', text=words, showarrow=False, font=font, **place)
