"""The figures of a finished run.

Nothing is computed here; long series are thinned to what a screen can show.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.drift import Trajectory2D
from gyrocal_ros.ekf.map import CeilingMap
from gyrocal_ros.ekf.run import History
from gyrocal_ros.ekf.state import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.pipeline.calibration import Calibration
from gyrocal_ros.report.figures.drawing import (
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    SIGMAS,
    TIME,
    VERMILLION,
    Place,
    band,
    dress,
    floor_plan,
    kept,
    line,
    logarithmic,
    panels,
    show,
    xy,
)
from gyrocal_ros.report.series import HeadingError, Windows


def scale_factor(history: History, calibration: Calibration) -> go.Figure:
    """The scale factor on its way to its final value, as in the paper's Fig. 10, and its uncertainty."""
    figure = make_subplots(
        rows=2,
        cols=2,
        specs=[[{}, {}], [{'colspan': 2}, None]],
        column_widths=[0.4, 0.6],
        horizontal_spacing=0.09,
        vertical_spacing=0.17,
        subplot_titles=['the beginning', 'the whole, magnified', 'how well it is known'],
    )
    dress(figure, 'Scale factor', 640)
    figure.update_layout(hovermode='x unified', margin_t=110, legend_y=1.06)
    figure.update_yaxes(title_text='true rate / nominal rate', row=1, col=1)
    figure.update_yaxes(title_text='% of the nominal, log scale', row=2, col=1)
    figure.update_xaxes(title_text=TIME, row=2, col=1)
    time_s, value = history.time_s, 1.0 + history.coefficients[:, 0]
    reach = SIGMAS * history.std[:, COEFFICIENTS_START]
    settled_s, volt = calibration.convergence_time_s, calibration.nominal_scale_factor_volt

    early = time_s <= (time_s[-1] if settled_s is None else max(30.0, 3.0 * settled_s))
    for place, part in (((1, 1), early), ((1, 2), time_s >= 0.0)):
        _estimate(figure, time_s[part], value[part], reach[part], 'scale factor', '.5f', place)
    figure.data[-1].showlegend = False
    show(figure, (1, 1), np.append(value[early], [1.0, value[-1]]))
    dotted, note = {'color': GREY, 'dash': 'dot'}, {'text': f'nominal, {volt:g} deg/s/V', 'yanchor': 'top'}
    figure.add_hline(1.0, row=1, col=1, line=dotted, annotation=note)

    rows = kept(value, reach)
    away = np.abs(value[rows] - value[-1])
    away[away == 0.0] = np.nan
    line(figure, time_s[rows], 100.0 * reach[rows], '3 sigma of the estimate', '.4f', (2, 1), BLUE, 'dash')
    line(figure, time_s[rows], 100.0 * away, 'distance from its final value', '.4f', (2, 1), VERMILLION)
    logarithmic(figure, (2, 1), 10.0 * reach[-1], 200.0 * reach.max())
    if settled_s is not None:
        note = {'text': f'converged after {settled_s:.0f} s'}
        figure.add_vline(settled_s, row=2, col=1, line=dotted, annotation=note)
    return figure


def live(time_s: Array, value: Array, std: Array, nis_time_s: Array, nis: Array) -> go.Figure:
    """The scale factor of a running robot on its way, and whether its filter is consistent.

    Args:
        time_s: (n,) when it was told.
        value: (n,)
        std: (n,)
        nis_time_s: (m,)
        nis: (m,) per degree of freedom.
    """
    figure = panels('Scale factor, as it is told', ['true rate /<br>nominal rate', 'NIS per dof'])
    if len(value):
        _estimate(figure, time_s, value, SIGMAS * std, 'scale factor', '.5f', (1, 1))
    rows = kept(nis) if len(nis) else np.arange(0)
    line(figure, nis_time_s[rows], nis[rows], 'NIS per degree of freedom', '.2f', (2, 1), GREEN)
    figure.add_hline(1.0, row=2, col=1, line={'color': GREY, 'dash': 'dot'})
    figure.update_xaxes(title_text='time since the listening began (s)', row=2, col=1)
    return figure


def coefficients(history: History, calibration: Calibration) -> go.Figure:
    """The other coefficients of the sensor model over time, one panel each."""
    names, units = calibration.names[2:], calibration.units[2:]
    titles = [f'{name.replace(".", "<br>")}<br>({unit})' for name, unit in zip(names, units, strict=True)]
    figure = panels('Other coefficients', titles)
    for i, name in enumerate(names, start=1):
        value, reach = history.coefficients[:, i], SIGMAS * history.std[:, COEFFICIENTS_START + i]
        _estimate(figure, history.time_s, value, reach, name, '.4g', (i, 1))
    figure.update_layout(showlegend=False)
    return figure


def bias(history: History) -> go.Figure:
    """The yaw bias over time, above the temperature where that was recorded."""
    has_temperature = bool(np.isfinite(history.temperature_c).any())
    figure = panels('Bias of the yaw gyro', ['bias (deg/s)', 'temperature (°C)'][: 1 + has_temperature])
    value, reach = np.degrees(history.mean[:, YAW_BIAS]), SIGMAS * np.degrees(history.std[:, YAW_BIAS])
    _estimate(figure, history.time_s, value, reach, 'bias', '.4f', (1, 1))
    if has_temperature:
        rows, warmth = kept(history.temperature_c), history.temperature_c
        line(figure, history.time_s[rows], warmth[rows], 'temperature', '.2f', (2, 1), PURPLE)
    return figure


def heading(history: History, error: HeadingError | None) -> go.Figure:
    """The heading, and its error against the ground truth; without one, what the filter says of it."""
    figure = panels('Heading', ['heading (deg)', 'uncertainty (deg)' if error is None else 'error (deg)'])
    value = np.degrees(history.mean[:, YAW])
    rows = kept(value)
    line(figure, history.time_s[rows], value[rows], 'heading by SLAM', '.1f', (1, 1), GREEN)
    if error is None:
        reach = SIGMAS * np.degrees(history.std[:, YAW])
        rows = kept(reach)
        band(figure, history.time_s[rows], np.zeros(len(rows)), reach[rows], (2, 1))
        return figure
    value, reach = np.degrees(error.error_rad), SIGMAS * np.degrees(error.std_rad)
    rows = kept(value, reach)
    band(figure, error.time_s[rows], np.zeros(len(rows)), reach[rows], (2, 1))
    line(figure, error.time_s[rows], value[rows], 'SLAM less ground truth', '.3f', (2, 1))
    return figure


def innovations(history: History, windows: Windows) -> go.Figure:
    """Whether the measurements differ from the predictions by as much as the filter expects."""
    has_features = bool(windows.used.any() or windows.rejected.any())
    has_heading = bool(np.isfinite(history.heading_innovation_std_rad).any())
    titles = ['NIS per dof', *['features'] * has_features, *['heading (deg)'] * has_heading]
    figure = panels('Innovations', titles, 190)
    for bound in (windows.low, windows.high):
        line(figure, windows.time_s, bound, '95 % bounds', '.2f', (1, 1), GREY, 'dash')
    figure.data[-1].showlegend = False
    line(figure, windows.time_s, windows.nis_per_dof, 'NIS per degree of freedom', '.2f', (1, 1), GREEN)
    if has_features:
        _feature_counts(figure, windows, (2, 1))
    if has_heading:
        _heading_innovations(figure, history, (len(titles), 1))
    figure.update_xaxes(range=[0.0, history.time_s[-1]])
    return figure


PATH_STYLES = {
    'ground truth': (GREY, 'solid', 6),
    'SLAM': (BLUE, 'solid', 2),
    'calibrated gyro': (GREEN, 'dash', 2),
    'nominal gyro': (VERMILLION, 'dot', 2),
}


def paths(tracks: Mapping[str, Trajectory2D]) -> go.Figure:
    """Where the robot went, by several ways of knowing it, as in the paper's Figs. 12 and 13.

    Args:
        tracks: by name; `PATH_STYLES` holds the known ones.
    """
    figure = floor_plan('Path')
    for name, track in tracks.items():
        colour, dash, width = PATH_STYLES.get(name, (PURPLE, 'dashdot', 2))
        rows = kept(*track.position_m.T)
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
    """How far each path of `paths` is from the ground truth."""
    figure = panels('Distance from the ground truth', ['distance (m), log scale'], 320)
    for name, distance in distances_m.items():
        rows = kept(distance)
        colour, dash, _ = PATH_STYLES[name]
        line(figure, time_s[rows], distance[rows], name, '.3f', (1, 1), colour, dash)
    largest = max(float(distance.max()) for distance in distances_m.values())
    logarithmic(figure, (1, 1), 0.001, max(2.0 * largest, 0.01))
    return figure


def ceiling_map(ceiling: CeilingMap, track: Trajectory2D) -> go.Figure:
    """The features of the map from above with their 3-sigma ellipses, as in the paper's Fig. 7."""
    figure = floor_plan('Map of the ceiling')
    outlines = ceiling.outlines(SIGMAS)
    ellipses = np.concatenate([outlines, np.full((len(outlines), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    for name, points, colour, width in (
        ('path', track.position_m[kept(*track.position_m.T)], GREY, 1.0),
        ('3 sigma', ellipses, VERMILLION, 1.5),
    ):
        line = {'color': colour, 'width': width}
        figure.add_scatter(**xy(*points.T), name=name, mode='lines', line=line, hoverinfo='skip')
    stds = np.sqrt(np.maximum(np.diagonal(ceiling.covariances_m2, axis1=1, axis2=2), 0.0))
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


def _feature_counts(figure: go.Figure, windows: Windows, place: Place) -> None:
    row, col = place
    line(figure, windows.time_s, windows.used, 'used, per image', '.1f', place, PURPLE)
    name, style = f'rejected in {windows.length_s:.0f} s', {'color': VERMILLION, 'line': {'width': 0}}
    bars = xy(windows.time_s, windows.rejected)
    figure.add_bar(**bars, name=name, marker=style, hovertemplate='%{y:.0f}', row=row, col=col)
    figure.update_yaxes(rangemode='tozero', row=row, col=col)


def _heading_innovations(figure: go.Figure, history: History, place: Place) -> None:
    measured = np.flatnonzero(np.isfinite(history.heading_innovation_std_rad))
    value = np.degrees(history.heading_innovation_rad[measured])
    reach = SIGMAS * np.degrees(history.heading_innovation_std_rad[measured])
    rows = kept(value, reach)
    time_s = history.time_s[measured[rows]]
    band(figure, time_s, np.zeros(len(rows)), reach[rows], place)
    line(figure, time_s, value[rows], 'innovation as a heading', '.3f', place)
    figure.data[-1].update(mode='markers', marker={'size': 3, 'color': BLUE})
    show(figure, place, np.percentile(np.concatenate([value, reach, -reach]), [0.5, 99.5]), margin=0.3)


def _estimate(
    figure: go.Figure, time_s: Array, value: Array, reach: Array, name: str, digits: str, place: Place
) -> None:
    """An estimate in the middle of its band, in a range that shows the end; a double click shows all."""
    rows = kept(value, reach)
    band(figure, time_s[rows], value[rows], reach[rows], place)
    line(figure, time_s[rows], value[rows], name, digits, place)
    hover = f'%{{y:{digits}}} ± %{{customdata:{digits}}} (3 sigma)'
    figure.data[-1].update(customdata=reach[rows].astype(np.float32), hovertemplate=hover)
    late = slice(len(value) // 2, None)
    show(figure, place, np.concatenate([(value - reach)[late], (value + reach)[late]]), margin=0.4)
