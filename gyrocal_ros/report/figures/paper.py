"""The figures of the paper, made anew. Nothing is computed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import Trajectory2D
from gyrocal_ros.ekf.map import CeilingMap
from gyrocal_ros.report.figures import calibration
from gyrocal_ros.report.figures.drawing import (
    AFTER,
    BEFORE,
    BLUE,
    GREEN,
    GREY,
    LOOKS,
    SIGMAS,
    VERMILLION,
    LineStyle,
    band,
    dress,
    kept,
    line,
    logarithmic,
    panels,
    points,
    show,
    xy,
)

OF_THE_PAPER = LineStyle(GREY, 'diamond-open', 'dot')


def feature_map(ceiling: CeilingMap, path: Trajectory2D, corners_m: Array) -> go.Figure:
    """The map with its ellipses, over the corners (c, 2) as they truly are."""
    figure = calibration.ceiling_map(ceiling, path)
    marker = {'symbol': 'cross-thin-open', 'size': 13, 'color': GREEN}
    figure.add_scatter(**xy(*corners_m.T), name='true corners', mode='markers', marker=marker)
    figure.update_layout(title_text='Feature map')
    return figure


def scale_by_rate(rates_deg_s: Array, samples: Mapping[str, tuple[Array, Array]]) -> go.Figure:
    """Scale factors on the rate table with their standard deviations, by name of the sample."""
    figure = panels('Scale factor on the rate table', ['scale factor (deg/s/V)'], 340)
    for look, (name, (volt, std)) in zip(LOOKS, samples.items(), strict=False):
        points(figure, rates_deg_s, volt, SIGMAS * std, name, '.3f', (1, 1), look, joined=True)
    figure.update_xaxes(title_text='rate of the table (deg/s); bars are 3 sigma')
    return figure


def at_rest(time_s: Array, read_deg_s: Array, modelled_deg_s: Array) -> go.Figure:
    """What the gyro reads at rest, the function fitted to it, and what is left over."""
    figure = panels('The gyro at rest', ['reading (deg/s)', 'less the fit (deg/s)'], 210)
    line(figure, time_s, read_deg_s, 'measured', '.4f', (1, 1), BLUE)
    line(figure, time_s, modelled_deg_s, 'fitted', '.4f', (1, 1), VERMILLION, 'dash')
    line(figure, time_s, read_deg_s - modelled_deg_s, 'difference', '.4f', (2, 1), GREY)
    return figure


def convergence(courses: Mapping[str, tuple[Array, Array, Array]], true_volt: float) -> go.Figure:
    """Time since the first motion, scale factor and its standard deviation, by name of the filter."""
    figure = panels(
        'Convergence of the scale factor', ['deg/s/V', 'magnified (deg/s/V)', 'error (deg/s/V), log'], 200
    )
    for look, (name, (time_s, volt, std)) in zip(
        (LOOKS[2], LOOKS[0], LOOKS[1]), courses.items(), strict=False
    ):
        if name == next(iter(courses)):
            rows = kept(volt, std)
            for row in (1, 2):
                band(figure, time_s[rows], volt[rows], SIGMAS * std[rows], (row, 1), f'3 sigma of {name}')
        for row in (1, 2):
            line(figure, time_s, volt, name, '.3f', (row, 1), look.colour, look.dash)
            figure.data[-1].showlegend = row == 1
        line(figure, time_s, np.abs(volt - true_volt), name, '.4f', (3, 1), look.colour, look.dash)
        figure.data[-1].showlegend = False
    for row in (1, 2):
        figure.add_hline(true_volt, row=row, col=1, line={'color': GREY, 'dash': 'dot'})
    figure.update_yaxes(range=[120.0, 155.0], row=1, col=1)
    figure.update_yaxes(range=[true_volt - 0.6, true_volt + 0.6], row=2, col=1)
    logarithmic(figure, (3, 1), 1e-3, 30.0)
    figure.update_xaxes(title_text='time since the first motion (s)', row=3, col=1)
    return figure


def ten_rotations(here: Mapping[str, Array], paper: Mapping[str, Array]) -> go.Figure:
    """Heading errors (10,) in deg after ten rotations, by name of the scale factor: here and in the paper."""
    titles = [f'{name} (deg)' for name in here]
    figure = panels('Heading error after ten rotations, the camera off', titles, 210)
    for row, (look, name) in enumerate(zip((BEFORE, AFTER), here, strict=True), start=1):
        runs, nothing = np.arange(1.0, 1.0 + len(here[name])), np.zeros(len(here[name]))
        points(figure, runs, here[name], nothing, f'{name}, here', '.2f', (row, 1), look)
        points(figure, runs, paper[name], nothing, 'paper', '.2f', (row, 1), OF_THE_PAPER)
    figure.update_xaxes(title_text='run: five to each side', row=2, col=1, dtick=1)
    return figure


def histograms(kinds: Mapping[str, tuple[Array, Array]], paper: tuple[float, float]) -> go.Figure:
    """Heading errors in deg after ten minutes, calibrated and nominal, by kind of gyro.

    Args:
        kinds: the two errors (n,) by name.
        paper: mean and standard deviation of the calibrated ones in the paper.
    """
    count = len(kinds)
    titles = [text for name in kinds for text in (f'calibrated: {name}', f'nominal: {name}')]
    figure = make_subplots(
        rows=count, cols=2, subplot_titles=titles, vertical_spacing=0.36 / count, horizontal_spacing=0.09
    )
    dress(figure, 'Heading error after ten minutes of cleaning', 130 + 200 * count)
    figure.update_layout(showlegend=False, bargap=0.08, margin_t=90)
    for row, errors in enumerate(kinds.values(), start=1):
        for col, (values, colour) in enumerate(zip(errors, (GREEN, VERMILLION), strict=True), start=1):
            width = 0.25 if col == 1 else 2.0
            reach = width * np.ceil((np.abs(values).max() + 0.5 * width) / width)
            bins = {'start': -reach, 'end': reach, 'size': width}
            figure.add_histogram(x=values, xbins=bins, marker_color=colour, row=row, col=col)
        mean, sd = paper
        shade = {'fillcolor': GREY, 'opacity': 0.2, 'line_width': 0}
        figure.add_vrect(mean - sd, mean + sd, row=row, col=1, **shade)
    figure.update_xaxes(title_text='heading error (deg); grey: mean ± sd of the paper', row=count, col=1)
    figure.update_xaxes(title_text='heading error (deg)', row=count, col=2)
    figure.update_yaxes(title_text='runs', dtick=1, col=1)
    return figure


def landmark_errors(
    title: str, moved_cm: Array, methods: Mapping[str, tuple[Array, Array]], bound_cm: Array
) -> go.Figure:
    """Error of a landmark's place against the way moved.

    Args:
        title: of the figure.
        moved_cm: (n,)
        methods: by name the errors (n,) in cm and their reach (2, n) down and up.
        bound_cm: (n,) a lower bound, drawn where it is positive and finite.
    """
    figure = panels(title, ['error of the place (cm), log scale'], 400)
    told = np.isfinite(bound_cm) & (bound_cm > 0.0)
    if told.any():
        line(figure, moved_cm[told], bound_cm[told], 'Cramer-Rao bound', '.1f', (1, 1), GREY, 'dash')
    for look, (name, (errors, reach)) in zip((LOOKS[2], LOOKS[1], LOOKS[0]), methods.items(), strict=False):
        points(figure, moved_cm, errors, reach, name, '.2f', (1, 1), look, joined=True)
    lowest = min(float(errors[errors > 0.0].min()) for errors, _ in methods.values())
    logarithmic(figure, (1, 1), max(0.5 * lowest, 1e-3), 1000.0)
    figure.update_xaxes(title_text='way moved (cm)')
    return figure


def end_errors(title: str, errors_m: Mapping[str, Array]) -> go.Figure:
    """Distances (seeds,) from the truth at the end, by name, one point a seed."""
    figure = panels(title, ['distance at the end (cm)'], 300)
    for look, (name, errors) in zip((LOOKS[1], LOOKS[0]), errors_m.items(), strict=False):
        look = replace(look, colour=calibration.PATH_STYLES[name][0])
        seeds = np.arange(float(len(errors)))
        points(figure, seeds, 100.0 * errors, np.zeros(len(errors)), name, '.1f', (1, 1), look)
    figure.update_xaxes(title_text='seed')
    every = 100.0 * np.concatenate(list(errors_m.values()))
    show(figure, (1, 1), np.append(every, 0.0))
    return figure


def tracks(title: str, paths: Mapping[str, Trajectory2D]) -> go.Figure:
    """Where the robot went, by several ways of knowing it."""
    figure = calibration.paths(paths)
    figure.update_layout(title_text=title)
    return figure


def growth(x_label: str, x: Sequence[float], lines: Mapping[str, Array], y_label: str) -> go.Figure:
    """A cost against a size, both on logarithmic axes; a straight line of slope 1 is dotted."""
    figure = panels(y_label.partition(' (')[0].capitalize(), [y_label], 340)
    sizes = np.array(x)
    for look, (name, values) in zip(LOOKS[1:], lines.items(), strict=False):
        points(figure, sizes, values, np.zeros(len(values)), name, '.3g', (1, 1), look, joined=True)
    first = next(iter(lines.values()))
    line(figure, sizes, first[0] * sizes / sizes[0], 'in proportion', '.3g', (1, 1), GREY, 'dot')
    figure.update_xaxes(title_text=x_label, type='log', hoverformat='.4g', dtick=1)
    figure.update_yaxes(type='log', dtick=1)
    return figure
