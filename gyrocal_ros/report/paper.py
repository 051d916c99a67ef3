"""The page of `gyrocal reproduce`: the figures of the paper beside the results of this package."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros import __version__
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D
from gyrocal_ros.ekf.state.map import CeilingMap
from gyrocal_ros.report import calibration_figures
from gyrocal_ros.report.html import FIGURE_HELP, Section, document, gallery, table
from gyrocal_ros.report.plot import (
    AFTER,
    BEFORE,
    GREEN,
    GREY,
    SIGMAS,
    STYLES,
    VERMILLION,
    LineStyle,
    band,
    kept_rows,
    line,
    panels,
    points,
    set_log_range,
    set_style,
    show_range,
    xy,
)

PAPER_STYLE = LineStyle(GREY, 'diamond-open', 'dot')
HEADS = ('claim', 'in the paper', 'here', 'verdict')
ABOUT = (
    'Lee, Choi, Park, Myung 2012, Self-calibration of Gyro using Monocular SLAM for an Indoor Mobile Robot, '
    f'reproduced with the simulator and the estimator of gyrocal {__version__}. {FIGURE_HELP}'
)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One figure or table of the paper."""

    title: str
    rows: Sequence[tuple[str, str, str, str]]
    """The claim, the paper's number, the number here, and whether the claim holds."""
    sections: Sequence[Section]


def paper_page(parts: Iterable[Part]) -> str:
    """Return the page as HTML text."""
    pieces = [
        piece
        for part in parts
        for piece in (table(part.title, HEADS, part.rows, wrap=True), gallery(part.sections, note=''))
    ]
    return document('The paper, reproduced', ABOUT, pieces)


def feature_map(ceiling: CeilingMap, path: Trajectory2D, corners_m: Array) -> go.Figure:
    """Draw the map with its ellipses over the true corners (c, 2)."""
    figure = calibration_figures.ceiling_map(ceiling, path)
    marker = {'symbol': 'cross-thin-open', 'size': 13, 'color': GREEN}
    figure.add_scatter(**xy(*corners_m.T), name='true corners', mode='markers', marker=marker)
    figure.update_layout(title_text='Feature map')
    return figure


def scale_by_rate(rates_deg_s: Array, samples: Mapping[str, tuple[Array, Array]]) -> go.Figure:
    """Draw scale factors on the rate table with their standard deviations, by name of the sample."""
    figure = panels('Scale factor on the rate table', ['scale factor (deg/s/V)'], 340)
    for style, (name, (volt, std)) in zip(STYLES, samples.items(), strict=False):
        points(figure, rates_deg_s, volt, SIGMAS * std, name, '.3f', style, joined=True)
    figure.update_xaxes(title_text='rate of the table (deg/s); bars are 3 sigma')
    return figure


def at_rest(time_s: Array, read_deg_s: Array, modelled_deg_s: Array) -> go.Figure:
    """Draw the readings of the gyro at rest, the function fitted to them, and the residual."""
    figure = panels('The gyro at rest', ['reading (deg/s)', 'less the fit (deg/s)'], 210)
    line(figure, time_s, read_deg_s, 'measured', '.4f')
    line(figure, time_s, modelled_deg_s, 'fitted', '.4f', (1, 1), VERMILLION, 'dash')
    line(figure, time_s, read_deg_s - modelled_deg_s, 'difference', '.4f', (2, 1), GREY)
    return figure


def convergence(courses: Mapping[str, tuple[Array, Array, Array]], true_volt: float) -> go.Figure:
    """Draw the scale factor over time, its error, and its band.

    Args:
        courses: by name of the filter the time since the first motion, scale factor and standard deviation;
            the band is that of the first one.
        true_volt: true scale factor.
    """
    titles = ['deg/s/V', 'magnified (deg/s/V)', 'error (deg/s/V), log']
    figure = panels('Convergence of the scale factor', titles, 200)
    for number, (name, (time_s, volt, std)) in enumerate(courses.items()):
        style = (STYLES[2], STYLES[0], STYLES[1])[number]
        if number == 0:
            rows = kept_rows(volt, std)
            for row in (1, 2):
                band(figure, time_s[rows], volt[rows], SIGMAS * std[rows], (row, 1), f'3 sigma of {name}')
        for row in (1, 2):
            line(figure, time_s, volt, name, '.3f', (row, 1), style.colour, style.dash)
            figure.data[-1].showlegend = row == 1
        line(figure, time_s, np.abs(volt - true_volt), name, '.4f', (3, 1), style.colour, style.dash)
        figure.data[-1].showlegend = False
    for row in (1, 2):
        figure.add_hline(true_volt, row=row, col=1, line={'color': GREY, 'dash': 'dot'})
    figure.update_yaxes(range=[120.0, 155.0], row=1, col=1)
    figure.update_yaxes(range=[true_volt - 0.6, true_volt + 0.6], row=2, col=1)
    set_log_range(figure, (3, 1), 1e-3, 30.0)
    figure.update_xaxes(title_text='time since the first motion (s)', row=3, col=1)
    return figure


def ten_rotations(here: Mapping[str, Array], paper: Mapping[str, Array]) -> go.Figure:
    """Draw heading errors (10,) in deg after ten rotations by scale factor, here and in the paper."""
    titles = [f'{name} (deg)' for name in here]
    figure = panels('Heading error after ten rotations, the camera off', titles, 210)
    for row, (style, name) in enumerate(zip((BEFORE, AFTER), here, strict=True), start=1):
        runs, zeros = np.arange(1.0, 1.0 + len(here[name])), np.zeros(len(here[name]))
        points(figure, runs, here[name], zeros, f'{name}, here', '.2f', style, (row, 1))
        points(figure, runs, paper[name], zeros, 'paper', '.2f', PAPER_STYLE, (row, 1))
    figure.update_xaxes(title_text='run: five to each side', row=2, col=1, dtick=1)
    return figure


def histograms(kinds: Mapping[str, tuple[Array, Array]], paper: tuple[float, float]) -> go.Figure:
    """Draw histograms of heading errors in deg after ten minutes.

    Args:
        kinds: by kind of gyro the errors (n,), calibrated and nominal.
        paper: mean and standard deviation of the calibrated ones in the paper.
    """
    count = len(kinds)
    titles = [text for name in kinds for text in (f'calibrated: {name}', f'nominal: {name}')]
    figure = make_subplots(
        rows=count, cols=2, subplot_titles=titles, vertical_spacing=0.36 / count, horizontal_spacing=0.09
    )
    set_style(figure, 'Heading error after ten minutes of cleaning', 130 + 200 * count)
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
    """Draw the position error of a landmark against the distance moved.

    Args:
        title: title of the figure.
        moved_cm: (n,)
        methods: by name the errors (n,) in cm and their reach (2, n) down and up.
        bound_cm: (n,) a lower bound, drawn where it is positive and finite.
    """
    figure = panels(title, ['error of the position (cm), log scale'], 400)
    known = np.isfinite(bound_cm) & (bound_cm > 0.0)
    if known.any():
        line(figure, moved_cm[known], bound_cm[known], 'Cramer-Rao bound', '.1f', (1, 1), GREY, 'dash')
    styles = (STYLES[2], STYLES[1], STYLES[0])
    for style, (name, (errors, reach)) in zip(styles, methods.items(), strict=False):
        points(figure, moved_cm, errors, reach, name, '.2f', style, joined=True)
    lowest = min(float(errors[errors > 0.0].min()) for errors, _ in methods.values())
    set_log_range(figure, (1, 1), max(0.5 * lowest, 1e-3), 1000.0)
    figure.update_xaxes(title_text='distance moved (cm)')
    return figure


def end_errors(title: str, errors_m: Mapping[str, Array]) -> go.Figure:
    """Draw distances (seeds,) from the truth at the end, by name, one point for each seed."""
    figure = panels(title, ['distance at the end (cm)'], 300)
    for style, (name, errors) in zip((STYLES[1], STYLES[0]), errors_m.items(), strict=False):
        coloured = replace(style, colour=calibration_figures.PATH_STYLES[name][0])
        seeds = np.arange(float(len(errors)))
        points(figure, seeds, 100.0 * errors, np.zeros(len(errors)), name, '.1f', coloured)
    figure.update_xaxes(title_text='seed')
    every = 100.0 * np.concatenate(list(errors_m.values()))
    show_range(figure, (1, 1), np.append(every, 0.0))
    return figure


def tracks(title: str, paths: Mapping[str, Trajectory2D]) -> go.Figure:
    """Draw trajectories by several sources."""
    figure = calibration_figures.paths(paths)
    figure.update_layout(title_text=title)
    return figure
