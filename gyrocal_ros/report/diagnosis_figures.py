"""Figures of a diagnosis: where the model fails, which effect explains it, what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import BlindDrift
from gyrocal_ros.diagnose.analysis.heading_filter import Headings
from gyrocal_ros.diagnose.analysis.regimes import Failure
from gyrocal_ros.diagnose.analysis.wander import Wander, wander
from gyrocal_ros.diagnose.series.error_curves import ErrorBySignal
from gyrocal_ros.diagnose.series.run_series import camera_off
from gyrocal_ros.diagnose.series.search_series import CandidateRow, EffectCurve
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.ekf.history.run import History
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.plot import (
    AFTER,
    BEFORE,
    BLUE,
    CLEAR,
    FIRST,
    GREEN,
    GREY,
    PURPLE,
    SIGMAS,
    VERMILLION,
    band,
    kept_rows,
    line,
    panels,
    points,
    set_style,
    show_range,
    styled,
)

HEADING = """Top: heading by the gyro alone over the whole recording, less the observed heading; the best
    constant bias is removed. Within the band the noise explains it. Middle: change of that error in each
    10 s, with three standard deviations. Bottom: motion of the robot."""
STRETCHES = ' Shaded: the stretches of time with the largest errors, the largest is number 1.'
MIN_GAIN = 0.3
"""Log-likelihood gain at which the axis begins."""
SHADE, DARKNESS = 'rgba(213,94,0,0.13)', 'rgba(128,128,128,0.3)'
PROPOSED = ((PURPLE, 'solid'), (GREY, 'dash'), (GREY, 'dot'))
"""Colour and dash of the curves of what may be added."""
ROLES = {
    'best': ('explains most', GREEN, GREEN, ''),
    'found': ('missing, by this diagnosis', GREEN, GREEN, ''),
    'twin': ('not distinguishable from it here', PURPLE, PURPLE, '/'),
    'significant': ('significant while it is missing', BLUE, BLUE, '.'),
    'chance': ('no more than chance', CLEAR, GREY, ''),
}
"""Label, fill colour, edge colour and pattern of the bars by role of the candidate."""


def heading_section(
    title: str,
    seen: Mapping[str, Headings],
    history: History,
    stretches: Sequence[Failure] = (),
    jump_s: float | None = None,
) -> Section:
    """Make the section about the heading by the gyro alone.

    Args:
        title: title of the figure.
        seen: headings by name of the model.
        history: motion of the robot.
        stretches: stretches of time to mark, the worst first.
        jump_s: time at which the bias jumped, if it did.
    """
    wanders = {name: wander(headings) for name, headings in seen.items()}
    rate_deg_s = np.degrees(history.turn_rad / history.dt_s)
    figure = where_it_fails(
        title, wanders, history.time_s, rate_deg_s, stretches, jump_s, camera_off(history)
    )
    return Section('heading', figure, HEADING + (STRETCHES if stretches else ''))


def where_it_fails(
    title: str,
    wanders: Mapping[str, Wander],
    time_s: Array,
    rate_deg_s: Array,
    stretches: Sequence[Failure] = (),
    jump_s: float | None = None,
    off_s: Sequence[tuple[float, float]] = (),
    drift: BlindDrift | None = None,
) -> go.Figure:
    """Draw heading errors of the gyro alone, their change in windows, and the turning rate.

    Args:
        title: title of the figure.
        wanders: heading errors by name of the model; the band is that of the last one.
        time_s: (s,)
        rate_deg_s: (s,) turning rate.
        stretches: stretches of time in which the model is off by more than chance, worst first.
        jump_s: time at which the bias jumped, if it did.
        off_s: beginning and end of each span without a heading by the camera.
        drift: drift without the camera, to mark the worst span.
    """
    titles = ['error<br>(deg)', 'change in<br>10 s (deg)', 'turning<br>(deg/s)']
    figure = panels(title, titles, 200)
    last = list(wanders.values())[-1]
    reach = SIGMAS * np.degrees(last.std_rad)
    band(figure, last.time_s, np.zeros(len(reach)), reach, FIRST, 'noise (3 sigma)')
    for name, item, style in styled(wanders):
        error = np.degrees(item.error_rad)
        line(figure, item.time_s, error, name, '.3f', FIRST, style.colour, style.dash)
        gained, reach = np.degrees(item.gained_rad), SIGMAS * np.degrees(item.gained_std_rad)
        points(figure, item.gained_s, gained, reach, name, '.3f', style, (2, 1))
    rows = kept_rows(rate_deg_s)
    line(figure, time_s[rows], rate_deg_s[rows], 'turning rate', '.1f', (3, 1), GREY)
    figure.data[-1].showlegend = False
    for from_s, to_s in off_s:
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
        side = 'right' if jump_s > 0.5 * float(time_s[-1]) else 'left'  # on the side with more room
        text = f' the bias jumped at {jump_s:.0f} s '
        _note(figure, jump_s, text, PURPLE, y=0.0, yanchor='bottom', xanchor=side)
    figure.update_xaxes(range=[0.0, float(time_s[-1])])
    return figure


def _worst_span(figure: go.Figure, drift: BlindDrift) -> None:
    """Mark the span without the camera with the largest drift."""
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
    text = f'worst without camera: {error_deg:.2f} deg'
    _note(figure, float(ends_s.mean()), text, PURPLE, y=0.05, yanchor='bottom')


def scores(table: Sequence[CandidateRow]) -> go.Figure:
    """Draw the log-likelihood gain and the significance of each candidate effect."""
    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.04)
    set_style(figure, 'Candidate effects', 150 + 36 * len(table))
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
            name='with the missing effects in the model',
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
    limit = {'text': f'threshold {DEFAULT_SETTINGS.significant_sigma:g}', 'yanchor': 'bottom'}
    figure.add_vline(
        DEFAULT_SETTINGS.significant_sigma,
        row=1,
        col=2,
        line={'color': GREY, 'dash': 'dash'},
        annotation=limit,
        annotation_position='bottom right',
    )
    most = max([row.gain for row in table] + [10.0])
    bounds = [np.log10(MIN_GAIN), np.log10(2.0 * most)]
    figure.update_xaxes(
        type='log', dtick=1, range=bounds, title_text='log-likelihood gain (log scale)', col=1
    )
    most = max([row.sigma for row in table] + [2.0 * DEFAULT_SETTINGS.significant_sigma])
    figure.update_xaxes(range=[0.0, 1.05 * most], title_text='significance (sigma)', col=2)
    figure.update_yaxes(categoryorder='array', categoryarray=names[::-1], showgrid=False)
    figure.update_layout(barmode='overlay', bargap=0.35)
    return figure


def contribution(name: str, drawn: EffectCurve) -> go.Figure:
    """Draw the contribution of an effect that was found, with three standard deviations."""
    figure = panels(f'Contribution of {name}', [drawn.y_label], 300)
    rows = kept_rows(drawn.y, drawn.std)
    band(figure, drawn.x[rows], drawn.y[rows], SIGMAS * drawn.std[rows])
    line(figure, drawn.x[rows], drawn.y[rows], 'estimate', '.4g', colour=GREEN)
    figure.update_xaxes(title_text=drawn.x_label, hoverformat='.4g')
    return figure


def error_by_signal(error: ErrorBySignal, names: tuple[str, str]) -> go.Figure:
    """Draw the error of the bias or the scale as a function of a recorded signal, before and after.

    Args:
        error: the curves.
        names: names of the models before and after.
    """
    kind, unit = ('scale', '%') if error.of_scale else ('bias', 'deg/s')
    size = 100.0 if error.of_scale else np.degrees(1.0)
    figure = panels(f'{kind.capitalize()} by {error.signal}', [f'error of the {kind} ({unit})'], 190)
    ranges = []
    for name, curve, style in zip(names, (error.before, error.after), (BEFORE, AFTER), strict=True):
        if curve is not None:
            value, reach = size * curve.values, SIGMAS * size * curve.stds
            points(figure, curve.knots, value, reach, name, '.3g', style, joined=True)
            ranges += [value, value + 0.6 * reach, value - 0.6 * reach]
    if error.by_effects is not None:
        value = size * error.by_effects.values
        line(figure, error.by_effects.knots, value, 'by the effects added', '.3g', FIRST, BLUE, 'dash')
        ranges.append(value)
    for (name, curve), (colour, dash) in zip(error.proposed.items(), PROPOSED, strict=False):
        if np.any(curve.stds):
            band(figure, curve.knots, size * curve.values, SIGMAS * size * curve.stds)
        line(figure, curve.knots, size * curve.values, name, '.3g', FIRST, colour, dash)
        ranges.append(size * curve.values)
    figure.add_hline(0.0, line={'color': GREY, 'width': 1})
    figure.update_xaxes(title_text=error.signal, hoverformat='.4g')
    show_range(figure, FIRST, np.concatenate(ranges), margin=0.1)
    return figure


def _note(figure: go.Figure, x: float, text: str, colour: str, **place: Any) -> None:
    """Add a text to the first panel."""
    font = {'color': colour, 'size': 14}
    figure.add_annotation(x=x, yref='y domain', text=text, showarrow=False, font=font, **place)
