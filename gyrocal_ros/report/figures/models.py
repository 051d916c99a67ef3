"""The figures in which models stand side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import BlindDrift
from gyrocal_ros.report.figures.drawing import (
    AFTER,
    BEFORE,
    GREY,
    LOOKS,
    SIGMAS,
    LineStyle,
    dress,
    kept,
    line,
    panels,
    points,
)
from gyrocal_ros.report.model_series import CoefficientOfModel
from gyrocal_ros.report.series import Windows

LOG_FROM = 8.0
"""Where the largest is so many times the smallest, the axis is logarithmic."""
BEYOND = 10.0
"""An interval without end leaves the panel: it is drawn so many times as long as its value."""


def drift_by_span(drifts: Mapping[str, BlindDrift], looks: Sequence[LineStyle] = LOOKS) -> go.Figure:
    """Heading error after spans without the camera, all over the run, by name of the model."""
    span_s = next(iter(drifts.values())).span_s
    figure = panels('Drift span by span', [f'heading error after {span_s:.0f} s (deg)'], 320)
    for place, (name, drift) in enumerate(drifts.items()):
        look = looks[place % len(looks)]
        size_deg = np.abs(np.degrees(drift.error_rad))
        label = f'{name}, rms {drift.rms_deg:.3g} deg'
        line(figure, drift.start_s, size_deg, label, '.3f', (1, 1), look.colour)
        figure.data[-1].update(
            mode='markers', marker={'symbol': look.symbol, 'size': 8, 'color': look.colour}
        )
        ends_s, rms_deg = drift.start_s[[0, -1]], np.full(2, drift.rms_deg)
        line(figure, ends_s, rms_deg, label, '.3f', (1, 1), look.colour, look.dash)
        figure.data[-1].update(showlegend=False, hoverinfo='skip', hovertemplate=None)
    every = np.concatenate([np.abs(np.degrees(drift.error_rad)) for drift in drifts.values()])
    figure.update_yaxes(type='log', tickvals=_log_ticks(every))
    figure.update_xaxes(title_text='beginning of the span (s)')
    rows_px = 20 * len(drifts)
    figure.update_layout(legend_orientation='v', margin_t=60 + rows_px, height=390 + rows_px)
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """The drift of one model, as one point of a series."""

    model: str
    series: str
    drift: BlindDrift
    is_kept: bool = True
    """One that was left out is drawn hollow and off the line."""


def drift_by_model(title: str, marks: Sequence[Mark], joined: bool = True) -> go.Figure:
    """Rms of the drift with the interval that holds in 90 of 100 recordings, model by model."""
    models = list(dict.fromkeys(mark.model for mark in marks))
    names = list(dict.fromkeys(mark.series for mark in marks))
    figure = panels(title, [f'heading error after<br>{marks[0].drift.span_s:.0f} s, rms (deg)'], 340)
    for place, name in enumerate(names):
        look, aside = (AFTER, BEFORE)[place % 2], 0.1 * (place - 0.5 * (len(names) - 1))
        for is_kept in (True, False):
            chosen = [mark for mark in marks if mark.series == name and mark.is_kept == is_kept]
            if chosen:
                _add_series(figure, models, chosen, name, look, aside, joined)
    _show_drifts(figure, np.array([(mark.drift.rms_deg, *mark.drift.interval_deg) for mark in marks]))
    figure.update_layout(hovermode='closest')
    _name_models(figure, models)
    return figure


def coefficients_by_model(
    told: Mapping[str, Sequence[CoefficientOfModel]], models: Sequence[str], joined: bool = True
) -> go.Figure:
    """Coefficients with three standard deviations, model by model, a panel each.

    Args:
        told: by name of the coefficient with its unit.
        models: all of them, in their order.
        joined: draw lines from model to model: each builds on the one before.
    """
    figure = panels('Coefficients', [name.replace('.', '<br>').replace(' (', '<br>(') for name in told], 170)
    for row, values in enumerate(told.values(), start=1):
        for is_kept, look in ((True, AFTER), (False, replace(AFTER, symbol='circle-open'))):
            chosen = [item for item in values if item.is_kept == is_kept]
            if chosen:
                x = np.array([models.index(item.model) for item in chosen], float)
                y, std = np.array([item.value for item in chosen]), np.array([item.std for item in chosen])
                name = 'estimate' if is_kept else 'of a trial that was left out'
                points(figure, x, y, SIGMAS * std, name, '.5g', (row, 1), look, joined and is_kept)
    figure.update_layout(hovermode='closest')
    _name_models(figure, models)
    return figure


def consistency(windows: Mapping[str, Windows]) -> go.Figure:
    """Whether each model foresees the measurements as well as it believes, by name of the model."""
    figure = panels('Innovations', ['NIS per dof'], 300)
    first = next(iter(windows.values()))
    for bound in (first.low, first.high):
        line(figure, first.time_s, bound, '95 % bounds', '.2f', (1, 1), GREY, 'dash')
    figure.data[-1].showlegend = False
    for place, (name, seen) in enumerate(windows.items()):
        look = LOOKS[place % len(LOOKS)]
        line(figure, seen.time_s, seen.nis_per_dof, name, '.2f', (1, 1), look.colour, look.dash)
    return figure


def heading_errors(title: str, errors_deg: Mapping[str, tuple[Array, Array]]) -> go.Figure:
    """Errors of the heading over time (s, deg), by name of the model."""
    figure = panels(title, ['error (deg)'], 300)
    for place, (name, (time_s, error)) in enumerate(errors_deg.items()):
        look, rows = LOOKS[place % len(LOOKS)], kept(error)
        line(figure, time_s[rows], error[rows], name, '.3f', (1, 1), look.colour, look.dash)
    return figure


def failures_by_model(found: Mapping[str, Mapping[str, float]]) -> go.Figure:
    """How sure it is that each model fails in each place: sigma by place, by name of the model."""
    places = list(dict.fromkeys(place for rows in found.values() for place in rows))
    figure = dress(go.Figure(), 'Where each model fails', 150 + 32 * len(places))
    for place, (name, rows) in enumerate(found.items()):
        look = LOOKS[place % len(LOOKS)]
        figure.add_scatter(
            x=list(rows.values()),
            y=list(rows),
            name=name,
            mode='markers',
            marker={'symbol': look.symbol, 'size': 10, 'color': look.colour},
            hovertemplate='%{x:.1f} sigma',
        )
    figure.update_xaxes(title_text='sigma: how far beyond chance', rangemode='tozero')
    figure.update_yaxes(title_text='', categoryorder='array', categoryarray=places[::-1])
    return figure


def _add_series(
    figure: go.Figure,
    models: Sequence[str],
    marks: Sequence[Mark],
    name: str,
    look: LineStyle,
    aside: float,
    joined: bool,
) -> None:
    is_kept = marks[0].is_kept
    is_line = joined and is_kept
    x = np.array([models.index(mark.model) for mark in marks]) + aside
    rms = np.array([mark.drift.rms_deg for mark in marks])
    low, high = np.array([mark.drift.interval_deg for mark in marks]).T
    shown = look if is_kept else replace(look, symbol=f'{look.symbol}-open')
    label = name if is_kept else f'{name}, left out'
    high = np.where(np.isfinite(high), high, BEYOND * rms)
    points(figure, x, rms, np.stack([rms - low, high - rms]), label, '.3g', (1, 1), shown, is_line)
    mode = 'lines+markers+text' if is_line else 'markers+text'
    words = [f' {value:.3g} ' for value in rms]
    side = 'middle left' if aside < 0.0 else 'middle right'
    figure.data[-1].update(mode=mode, text=words, textposition=side, textfont={'color': look.colour})


def _show_drifts(figure: go.Figure, told: Array) -> None:
    """Let the panel show all values with their intervals (n, 3); those without end leave it."""
    rms, low, high = told.T
    top = 1.1 * float(np.where(np.isfinite(high), high, 2.0 * rms).max())
    if rms.max() > LOG_FROM * rms.min():
        bounds = np.log10([0.8 * low.min(), top])
        figure.update_yaxes(type='log', tickvals=_log_ticks(told), range=bounds)
    else:
        figure.update_yaxes(range=[0.0, top])


def _log_ticks(values: Array) -> list[float]:
    """Powers of ten, and twice and five times these where there are few."""
    known = values[(values > 0.0) & np.isfinite(values)]
    if not len(known):
        return []
    first, last = (math.floor(math.log10(value)) for value in (known.min(), known.max()))
    steps = (1.0, 2.0, 5.0) if last - first <= 2 else (1.0,)
    return [step * 10.0**power for power in range(first, last + 2) for step in steps]


def _name_models(figure: go.Figure, models: Sequence[str]) -> None:
    figure.update_xaxes(
        tickvals=list(range(len(models))),
        ticktext=[model.replace(':', ':<br>') for model in models],
        range=[-0.5, len(models) - 0.5],
        showgrid=False,
        title_text='',
    )
