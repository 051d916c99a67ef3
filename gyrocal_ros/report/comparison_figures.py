"""Figures of several models side by side: drift, coefficients, consistency, places where they fail."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import REFERENCES, BlindDrift
from gyrocal_ros.diagnose.series.model_series import CoefficientEstimate
from gyrocal_ros.diagnose.series.run_series import Windows
from gyrocal_ros.report.calibration_figures import nis_bounds
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.plot import (
    AFTER,
    BEFORE,
    FIRST,
    SIGMAS,
    LineStyle,
    kept_rows,
    line,
    panels,
    points,
    set_style,
    styled,
)

DRIFT = """Heading error after {span_s:.0f} s without the camera, compared with {reference}. Held out: each
    span starts with the estimates of that moment, so nothing was fitted on what follows. The bars are 90 %
    intervals. The spans are the same for all models, so differences can be significant even where bars
    overlap."""
HEADROOM = 1.3
"""Top of the axis of drifts, relative to the largest."""
NOISE_BAND = 'rgba(0,114,178,0.18)'
OPEN_END = 10.0
"""Ratio to the value at which an unbounded interval is drawn to end, which is outside the panel."""


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """The drift of one model, as one point of a series."""

    model: str
    series: str
    drift: BlindDrift
    is_kept: bool = True
    """False for a model that was left out, drawn hollow and off the line."""


def drift_section(
    title: str, marks: Sequence[Mark], joined: bool = True, half: bool = False, more: str = ''
) -> Section:
    """Make the section about the drift of each model.

    Args:
        title: title of the figure.
        marks: one or more drifts.
        joined: draw lines from model to model, where each builds on the one before.
        half: place it beside another section.
        more: further sentences of the caption.
    """
    drift = marks[0].drift
    caption = DRIFT.format(span_s=drift.span_s, reference=REFERENCES[drift.reference])
    return Section('drift', drift_by_model(title, marks, joined), f'{caption} {more}'.strip(), half)


def drift_by_span(drifts: Mapping[str, BlindDrift]) -> go.Figure:
    """Draw heading errors after spans without the camera over the run, by name of the model."""
    span_s = next(iter(drifts.values())).span_s
    figure = panels('Drift span by span', [f'heading error after {span_s:.0f} s (deg)'], 320)
    for name, drift, style in styled(drifts):
        size_deg = np.abs(np.degrees(drift.error_rad))
        label = f'{name}, rms {drift.rms_deg:.3g} deg'
        line(figure, drift.start_s, size_deg, label, '.3f', colour=style.colour)
        figure.data[-1].update(
            mode='markers', marker={'symbol': style.symbol, 'size': 8, 'color': style.colour}
        )
        ends_s, rms_deg = drift.start_s[[0, -1]], np.full(2, drift.rms_deg)
        line(figure, ends_s, rms_deg, label, '.3f', FIRST, style.colour, style.dash)
        figure.data[-1].update(showlegend=False, hoverinfo='skip', hovertemplate=None)
    every = np.concatenate([np.abs(np.degrees(drift.error_rad)) for drift in drifts.values()])
    figure.update_yaxes(type='log', tickvals=_log_ticks(every))
    figure.update_xaxes(title_text='beginning of the span (s)')
    rows_px = 20 * len(drifts)
    figure.update_layout(legend_orientation='v', margin_t=60 + rows_px, height=390 + rows_px)
    return figure


def drift_by_model(
    title: str, marks: Sequence[Mark], joined: bool = True, by_noise_deg: float | None = None
) -> go.Figure:
    """Draw the rms of the drift with its 90 % interval, model by model.

    Args:
        title: title of the figure.
        marks: one or more drifts.
        joined: draw lines from model to model, where each builds on the one before.
        by_noise_deg: drift that noise explains, if that is to be marked.
    """
    models = list(dict.fromkeys(mark.model for mark in marks))
    names = list(dict.fromkeys(mark.series for mark in marks))
    figure = panels(title, [f'heading error after<br>{marks[0].drift.span_s:.0f} s, rms (deg)'], 340)
    for place, name in enumerate(names):
        style, aside = (AFTER, BEFORE)[place % 2], 0.1 * (place - 0.5 * (len(names) - 1))
        for is_kept in (True, False):
            chosen = [mark for mark in marks if mark.series == name and mark.is_kept == is_kept]
            if chosen:
                _add_series(figure, models, chosen, name, style, aside, joined)
    _show_drifts(figure, np.array([mark.drift.rms_deg for mark in marks]))
    if by_noise_deg is not None and math.isfinite(by_noise_deg):
        _mark_noise(figure, by_noise_deg)
    figure.update_layout(hovermode='closest')
    _name_models(figure, models)
    return figure


def coefficients_by_model(
    found: Mapping[str, Sequence[CoefficientEstimate]], models: Sequence[str], joined: bool = True
) -> go.Figure:
    """Draw coefficients with three standard deviations, model by model, a panel each.

    Args:
        found: estimates by name of the coefficient with its unit.
        models: labels of all models in their order.
        joined: draw lines from model to model, where each builds on the one before.
    """
    figure = panels('Coefficients', [name.replace('.', '<br>').replace(' (', '<br>(') for name in found], 170)
    for row, values in enumerate(found.values(), start=1):
        for is_kept, style in ((True, AFTER), (False, replace(AFTER, symbol='circle-open'))):
            chosen = [item for item in values if item.is_kept == is_kept]
            if chosen:
                x = np.array([models.index(item.model) for item in chosen], float)
                y, std = np.array([item.value for item in chosen]), np.array([item.std for item in chosen])
                name = 'estimate' if is_kept else 'of a revision left out'
                points(figure, x, y, SIGMAS * std, name, '.5g', style, (row, 1), joined and is_kept)
    figure.update_layout(hovermode='closest')
    _name_models(figure, models)
    return figure


def consistency(windows: Mapping[str, Windows]) -> go.Figure:
    """Draw the NIS with its bounds over time, by name of the model."""
    figure = panels('Innovations', ['NIS per dof'], 300)
    nis_bounds(figure, next(iter(windows.values())))
    for name, seen, style in styled(windows):
        line(figure, seen.time_s, seen.nis_per_dof, name, '.2f', FIRST, style.colour, style.dash)
    return figure


def heading_errors(title: str, errors_deg: Mapping[str, tuple[Array, Array]]) -> go.Figure:
    """Draw heading errors over time (s, deg), by name of the model."""
    figure = panels(title, ['error (deg)'], 300)
    for name, (time_s, error), style in styled(errors_deg):
        rows = kept_rows(error)
        line(figure, time_s[rows], error[rows], name, '.3f', FIRST, style.colour, style.dash)
    return figure


def failures_by_model(found: Mapping[str, Mapping[str, float]]) -> go.Figure:
    """Draw the sigma of failures by place, by name of the model."""
    places = list(dict.fromkeys(place for rows in found.values() for place in rows))
    figure = set_style(go.Figure(), 'Where each model fails', 150 + 32 * len(places))
    for name, rows, style in styled(found):
        figure.add_scatter(
            x=list(rows.values()),
            y=list(rows),
            name=name,
            mode='markers',
            marker={'symbol': style.symbol, 'size': 10, 'color': style.colour},
            hovertemplate='%{x:.1f} sigma',
        )
    figure.update_xaxes(title_text='significance (sigma)', rangemode='tozero')
    figure.update_yaxes(title_text='', categoryorder='array', categoryarray=places[::-1])
    return figure


def _add_series(
    figure: go.Figure,
    models: Sequence[str],
    marks: Sequence[Mark],
    name: str,
    style: LineStyle,
    aside: float,
    joined: bool,
) -> None:
    is_kept = marks[0].is_kept
    is_line = joined and is_kept
    x = np.array([models.index(mark.model) for mark in marks]) + aside
    rms = np.array([mark.drift.rms_deg for mark in marks])
    low, high = np.array([mark.drift.interval_deg for mark in marks]).T
    shown = style if is_kept else replace(style, symbol=f'{style.symbol}-open')
    label = name if is_kept else f'{name}, left out'
    high = np.where(np.isfinite(high), high, OPEN_END * rms)
    points(figure, x, rms, np.stack([rms - low, high - rms]), label, '.3g', shown, joined=is_line)
    mode = 'lines+markers+text' if is_line else 'markers+text'
    words = [f' {value:.3g} ' for value in rms]
    side = 'top left' if aside < 0.0 else 'top right'
    figure.data[-1].update(mode=mode, text=words, textposition=side, textfont={'color': style.colour})


def _show_drifts(figure: go.Figure, rms_deg: Array) -> None:
    """Show the panel from zero to above the largest rms (n,): so an error that falls is seen to fall."""
    figure.update_yaxes(range=[0.0, HEADROOM * float(rms_deg.max())])


def _mark_noise(figure: go.Figure, by_noise_deg: float) -> None:
    """Mark the drift that noise explains, below which no model can come."""
    figure.add_hrect(0.0, by_noise_deg, fillcolor=NOISE_BAND, line_width=0, layer='below')
    figure.update_layout(title_text=f'{figure.layout.title.text} (by noise alone: {by_noise_deg:.2g} deg)')


def _log_ticks(values: Array) -> list[float]:
    """Return powers of ten, with twice and five times each where there are few."""
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
