"""Figures of a calibration: coefficients, trajectory, map, heading, innovations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import HeadingError
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D
from gyrocal_ros.diagnose.series.run_series import CONFIDENCE, Windows
from gyrocal_ros.effects.base import shown_in
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.history.scatter import scatter_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.ekf.state.map import CeilingMap
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.report.plot import (
    BLUE,
    FIRST,
    GREEN,
    GREY,
    PURPLE,
    SIGMAS,
    TIME,
    VERMILLION,
    Panel,
    band,
    floor_plan,
    kept_rows,
    line,
    panels,
    set_log_range,
    set_style,
    show_range,
    xy,
)

PATH_STYLES = {
    'ground truth': (GREY, 'solid', 6),
    'SLAM': (BLUE, 'solid', 2),
    'calibrated gyro': (GREEN, 'dash', 2),
    'nominal gyro': (VERMILLION, 'dot', 2),
}
"""Colour, dash and width of trajectories by their source."""


def scale_factor(history: History, calibration: Calibration) -> go.Figure:
    """Draw the convergence of the scale factor, as in the paper's Fig. 10, and its uncertainty."""
    figure = make_subplots(
        rows=2,
        cols=2,
        specs=[[{}, {}], [{'colspan': 2}, None]],
        column_widths=[0.4, 0.6],
        horizontal_spacing=0.09,
        vertical_spacing=0.17,
        subplot_titles=['the beginning', 'the whole run, magnified', 'uncertainty'],
    )
    set_style(figure, 'Scale factor', 640)
    figure.update_layout(hovermode='x unified', margin_t=110, legend_y=1.06)
    figure.update_yaxes(title_text='true rate / nominal rate', row=1, col=1)
    figure.update_yaxes(title_text='% of the nominal, log scale', row=2, col=1)
    figure.update_xaxes(title_text=TIME, row=2, col=1)
    time_s, value = history.time_s, 1.0 + history.coefficients[:, 0]
    reach = SIGMAS * history.std[:, COEFFICIENTS_START]
    settled_s, volt = calibration.convergence_time_s, calibration.nominal_scale_factor_volt

    early = time_s <= (time_s[-1] if settled_s is None else max(30.0, 3.0 * settled_s))
    for panel, part in (((1, 1), early), ((1, 2), time_s >= 0.0)):
        _estimate(figure, time_s[part], value[part], reach[part], 'scale factor', '.5f', panel)
    figure.data[-1].showlegend = False
    show_range(figure, (1, 1), np.append(value[early], [1.0, value[-1]]))
    dotted, note = {'color': GREY, 'dash': 'dot'}, {'text': f'nominal, {volt:g} deg/s/V', 'yanchor': 'top'}
    figure.add_hline(1.0, row=1, col=1, line=dotted, annotation=note)

    rows = kept_rows(value, reach)
    away = np.abs(value[rows] - value[-1])
    away[away == 0.0] = np.nan
    line(figure, time_s[rows], 100.0 * reach[rows], '3 sigma of the estimate', '.4f', (2, 1), BLUE, 'dash')
    line(figure, time_s[rows], 100.0 * away, 'distance from its final value', '.4f', (2, 1), VERMILLION)
    set_log_range(figure, (2, 1), 10.0 * reach[-1], 200.0 * reach.max())
    if settled_s is not None:
        note = {'text': f'converged after {settled_s:.0f} s'}
        figure.add_vline(settled_s, row=2, col=1, line=dotted, annotation=note)
    return figure


def live(time_s: Array, value: Array, std: Array, nis_time_s: Array, nis: Array) -> go.Figure:
    """Draw the convergence of the scale factor on a running robot, and the NIS of its filter.

    Args:
        time_s: (n,) times of the messages.
        value: (n,)
        std: (n,)
        nis_time_s: (m,)
        nis: (m,) per degree of freedom.
    """
    figure = panels('Scale factor, as published', ['true rate /<br>nominal rate', 'NIS per dof'])
    if len(value):
        _estimate(figure, time_s, value, SIGMAS * std, 'scale factor', '.5f')
    rows = kept_rows(nis) if len(nis) else np.arange(0)
    line(figure, nis_time_s[rows], nis[rows], 'NIS per degree of freedom', '.2f', (2, 1), GREEN)
    figure.add_hline(1.0, row=2, col=1, line={'color': GREY, 'dash': 'dot'})
    figure.update_xaxes(title_text='time since subscribing (s)', row=2, col=1)
    return figure


def coefficients(run: Run, start: int = 0, truth: Mapping[str, float] = {}) -> go.Figure:
    """Draw bias and coefficients over time, one panel each, with three standard deviations.

    The standard deviations are those that the scatter up to each moment supports, as in every result.

    Args:
        run: the run.
        start: first one to draw, in the order bias, scale factor, all others.
        truth: true values of coefficients by name, where they are known.
    """
    history = run.history
    reaches = SIGMAS * history.std[:, YAW_BIAS:] * scatter_of(run)[1]
    names = ('bias', *run.model.coefficient_names)
    units = ('rad/s', *(item.unit for item in run.model.coefficients))
    shown = [(i, names[i], *shown_in(units[i])) for i in range(start, len(names))]
    titles = [f'{name.replace(".", "<br>")}<br>({unit})' for _, name, unit, _ in shown]
    figure = panels('Coefficients over time', titles)
    for row, (i, name, _, factor) in enumerate(shown, start=1):
        value, reach = factor * history.mean[:, YAW_BIAS + i], factor * reaches[:, i]
        _estimate(figure, history.time_s, value, reach, name, '.4g', (row, 1))
        if name in truth:
            _true_value(figure, factor * truth[name], value, reach, (row, 1))
    figure.update_layout(showlegend=False)
    return figure


def _true_value(figure: go.Figure, truth: float, value: Array, reach: Array, panel: Panel) -> None:
    """Add the true value of a coefficient to the panel of its estimate."""
    dotted = {'color': VERMILLION, 'width': 2, 'dash': 'dot'}
    note = {'text': f'truth {truth:.4g}', 'font': {'color': VERMILLION}, 'yanchor': 'bottom'}
    figure.add_hline(truth, row=panel[0], col=panel[1], line=dotted, annotation=note)
    late = slice(len(value) // 2, None)
    show_range(figure, panel, np.concatenate([(value - reach)[late], (value + reach)[late], [truth]]), 0.4)


def bias(history: History) -> go.Figure:
    """Draw the yaw bias over time, above the temperature where that was recorded."""
    has_temperature = bool(np.isfinite(history.temperature_c).any())
    figure = panels('Bias of the yaw gyro', ['bias (deg/s)', 'temperature (°C)'][: 1 + has_temperature])
    value, reach = np.degrees(history.mean[:, YAW_BIAS]), SIGMAS * np.degrees(history.std[:, YAW_BIAS])
    _estimate(figure, history.time_s, value, reach, 'bias', '.4f')
    if has_temperature:
        rows, warmth = kept_rows(history.temperature_c), history.temperature_c
        line(figure, history.time_s[rows], warmth[rows], 'temperature', '.2f', (2, 1), PURPLE)
    return figure


def heading(history: History, error: HeadingError | None) -> go.Figure:
    """Draw the heading and its error against the ground truth; without one, its standard deviation."""
    figure = panels('Heading', ['heading (deg)', 'uncertainty (deg)' if error is None else 'error (deg)'])
    value = np.degrees(history.mean[:, YAW])
    rows = kept_rows(value)
    line(figure, history.time_s[rows], value[rows], 'heading by SLAM', '.1f', (1, 1), GREEN)
    time_s, std = (history.time_s, history.std[:, YAW]) if error is None else (error.time_s, error.std_rad)
    reach = SIGMAS * np.degrees(std)
    errors = np.zeros(len(reach)) if error is None else np.degrees(error.error_rad)
    rows = kept_rows(reach) if error is None else kept_rows(errors, reach)
    band(figure, time_s[rows], np.zeros(len(rows)), reach[rows], (2, 1))
    if error is not None:
        line(figure, time_s[rows], errors[rows], 'SLAM less ground truth', '.3f', (2, 1))
    return figure


def innovations(history: History, windows: Windows) -> go.Figure:
    """Draw the NIS with its bounds, the numbers of features, and the innovations as headings."""
    has_features = bool(windows.used.any() or windows.rejected.any())
    has_heading = bool(np.isfinite(history.heading_innovation_std_rad).any())
    titles = ['NIS per dof', *['features'] * has_features, *['heading (deg)'] * has_heading]
    figure = panels('Innovations', titles, 190)
    nis_bounds(figure, windows)
    line(figure, windows.time_s, windows.nis_per_dof, 'NIS per degree of freedom', '.2f', (1, 1), GREEN)
    if has_features:
        _feature_counts(figure, windows, (2, 1))
    if has_heading:
        _heading_innovations(figure, history, (len(titles), 1))
    figure.update_xaxes(range=[0.0, history.time_s[-1]])
    return figure


def nis_bounds(figure: go.Figure, windows: Windows) -> None:
    """Add the bounds of the NIS of a consistent filter to the first panel."""
    for bound in (windows.low, windows.high):
        line(figure, windows.time_s, bound, f'{100.0 * CONFIDENCE:.0f} % bounds', '.2f', FIRST, GREY, 'dash')
    figure.data[-1].showlegend = False


def paths(tracks: Mapping[str, Trajectory2D]) -> go.Figure:
    """Draw trajectories by several sources, as in the paper's Figs. 12 and 13.

    Args:
        tracks: trajectories by name; those of `PATH_STYLES` have a colour of their own.
    """
    figure = floor_plan('Path')
    for name, track in tracks.items():
        colour, dash, width = PATH_STYLES.get(name, (PURPLE, 'dashdot', 2))
        rows = kept_rows(*track.position_m.T)
        figure.add_scatter(
            **xy(*track.position_m[rows].T),
            name=name,
            mode='lines',
            customdata=track.time_s[rows].astype(np.float32),
            line={'color': colour, 'dash': dash, 'width': width},
            opacity=0.6 if name == 'ground truth' else 1.0,
            hovertemplate='(%{x:.2f}, %{y:.2f}) m after %{customdata:.1f} s',
        )
        figure.add_scatter(
            **xy(*track.position_m[-1:].T),
            name=name,
            mode='markers',
            showlegend=False,
            marker={'symbol': 'x', 'size': 10, 'color': colour},
            hovertemplate='end (%{x:.2f}, %{y:.2f}) m',
        )
    return figure


def distances(time_s: Array, distances_m: Mapping[str, Array]) -> go.Figure:
    """Draw the distances of trajectories from the ground truth; the names are those of `PATH_STYLES`."""
    figure = panels('Distance from the ground truth', ['distance (m), log scale'], 320)
    for name, distance in distances_m.items():
        rows = kept_rows(distance)
        colour, dash, _ = PATH_STYLES[name]
        line(figure, time_s[rows], distance[rows], name, '.3f', (1, 1), colour, dash)
    largest = max(float(distance.max()) for distance in distances_m.values())
    set_log_range(figure, (1, 1), 0.001, max(2.0 * largest, 0.01))
    return figure


def ceiling_map(ceiling: CeilingMap, track: Trajectory2D) -> go.Figure:
    """Draw the features of the map from above with their 3-sigma ellipses, as in the paper's Fig. 7."""
    figure = floor_plan('Map of the ceiling')
    outlines = ceiling.outlines(SIGMAS)
    ellipses = np.concatenate([outlines, np.full((len(outlines), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    for name, points, colour, width in (
        ('path', track.position_m[kept_rows(*track.position_m.T)], GREY, 1.0),
        ('3 sigma', ellipses, VERMILLION, 1.5),
    ):
        line = {'color': colour, 'width': width}
        figure.add_scatter(**xy(*points.T), name=name, mode='lines', line=line, hoverinfo='skip')
    stds = ceiling.stds_m
    about = np.concatenate([ceiling.ids[:, None], ceiling.points_m[:, 2:], stds], axis=1)
    for name, rows, symbol in (
        ('seen in the last image', ceiling.in_view, 'circle'),
        ('remembered', ~ceiling.in_view, 'circle-open'),
    ):
        figure.add_scatter(
            **xy(*ceiling.points_m[rows, :2].T),
            customdata=about[rows],
            name=name,
            mode='markers',
            marker={'symbol': symbol, 'size': 7, 'color': BLUE},
            hovertemplate='feature %{customdata[0]:.0f}: (%{x:.3f}, %{y:.3f}, %{customdata[1]:.3f}) m<br>'
            '1 sigma (%{customdata[2]:.4f}, %{customdata[3]:.4f}, %{customdata[4]:.4f}) m',
        )
    well_known = np.concatenate([track.position_m, ceiling.points_m[stds[:, :2].max(axis=1) < 1.0, :2]])
    low, high = well_known.min(axis=0) - 0.3, well_known.max(axis=0) + 0.3
    figure.update_layout(xaxis_range=[low[0], high[0]], yaxis_range=[low[1], high[1]])
    return figure


def _feature_counts(figure: go.Figure, windows: Windows, panel: Panel) -> None:
    row, col = panel
    line(figure, windows.time_s, windows.used, 'used, per image', '.1f', panel, PURPLE)
    name, style = f'rejected in {windows.length_s:.0f} s', {'color': VERMILLION, 'line': {'width': 0}}
    bars = xy(windows.time_s, windows.rejected)
    figure.add_bar(**bars, name=name, marker=style, hovertemplate='%{y:.0f}', row=row, col=col)
    figure.update_yaxes(rangemode='tozero', row=row, col=col)


def _heading_innovations(figure: go.Figure, history: History, panel: Panel) -> None:
    measured = np.flatnonzero(np.isfinite(history.heading_innovation_std_rad))
    value = np.degrees(history.heading_innovation_rad[measured])
    reach = SIGMAS * np.degrees(history.heading_innovation_std_rad[measured])
    rows = kept_rows(value, reach)
    time_s = history.time_s[measured[rows]]
    band(figure, time_s, np.zeros(len(rows)), reach[rows], panel)
    line(figure, time_s, value[rows], 'innovation as a heading', '.3f', panel)
    figure.data[-1].update(mode='markers', marker={'size': 3, 'color': BLUE})
    show_range(figure, panel, np.percentile(np.concatenate([value, reach, -reach]), [0.5, 99.5]), margin=0.3)


def _estimate(
    figure: go.Figure, time_s: Array, value: Array, reach: Array, name: str, digits: str, panel: Panel = FIRST
) -> None:
    """Add an estimate with its band; the range is that of the second half, a double click shows all."""
    rows = kept_rows(value, reach)
    band(figure, time_s[rows], value[rows], reach[rows], panel)
    line(figure, time_s[rows], value[rows], name, digits, panel)
    hover = f'%{{y:{digits}}} ± %{{customdata:{digits}}} (3 sigma)'
    figure.data[-1].update(customdata=reach[rows].astype(np.float32), hovertemplate=hover)
    late = slice(len(value) // 2, None)
    show_range(figure, panel, np.concatenate([(value - reach)[late], (value + reach)[late]]), margin=0.4)
