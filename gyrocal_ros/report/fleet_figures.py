"""Figures of a fleet: robots in order of their scale factor, tolerance, ageing, effect sizes."""

from __future__ import annotations

import numpy as np
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array
from gyrocal_ros.fleet.findings import AGE, Findings, age_h
from gyrocal_ros.fleet.hierarchy import FleetEstimate
from gyrocal_ros.report.html import Section
from gyrocal_ros.report.plot import AFTER, BEFORE, BLUE, GREY, SIGMAS, line, points, set_style, xy

MAX_BARS = 400
"""Number of robots up to which each is drawn with its error bar."""
HISTOGRAM_BINS = 40


def fleet_sections(found: Findings, tolerance: float) -> list[Section]:
    """Return the figures that the fleet has data for.

    Args:
        found: the findings.
        tolerance: relative tolerance of the scale factor by the data sheet.
    """
    scale = found.coefficients.get('scale_factor')
    sections = []
    if scale is not None:
        sections += [_forest(found, scale), _histogram(scale, tolerance)]
        if AGE in scale.slopes:
            sections.append(_ageing(found, scale))
    if found.effects:
        sections.append(_effects(found))
    return sections


def _forest(found: Findings, scale: FleetEstimate) -> Section:
    order = np.argsort(scale.robot_value)
    order = order[np.isfinite(scale.robot_value[order])]
    place = np.arange(len(order), dtype=float)
    outside = np.isin(order, scale.out_of_family)
    figure = set_style(make_subplots(), 'Scale factor of each robot', 430)
    for name, chosen, style in (('in family', ~outside, AFTER), ('out of family', outside, BEFORE)):
        if chosen.any() and len(order) <= MAX_BARS:
            value, std = scale.robot_value[order[chosen]], scale.robot_std[order[chosen]]
            points(figure, place[chosen], value, SIGMAS * std, name, '.5f', style)
            figure.data[-1].text = [found.robots[robot] for robot in order[chosen]]
            figure.data[-1].hovertemplate = '%{text}: %{y:.5f}'
        elif chosen.any():
            figure.add_scattergl(
                **xy(place[chosen], scale.robot_value[order[chosen]]),
                name=name,
                mode='markers',
                marker={'color': style.colour, 'symbol': style.symbol, 'size': 5},
                text=[found.robots[robot] for robot in order[chosen]],
                hovertemplate='%{text}: %{y:.5f}',
            )
    mean = scale.mean
    figure.add_hline(y=mean.value, line={'color': BLUE, 'dash': 'dash'})
    figure.add_hrect(
        y0=mean.value - scale.spread.value,
        y1=mean.value + scale.spread.value,
        fillcolor='rgba(0,114,178,0.15)',
        line_width=0,
    )
    figure.update_xaxes(title_text='robots in the order of their scale factor')
    figure.update_yaxes(title_text='scale factor at 25 °C and zero age (1)')
    caption = (
        f'Each robot with {SIGMAS:.0f} sigma (where they are at most {MAX_BARS}), shrunk towards the fleet '
        f'mean (dashed). Band: part-to-part spread of 1 sigma, {100 * scale.spread.value:.3f} %.'
    )
    return Section('robots', figure, caption)


def _histogram(scale: FleetEstimate, tolerance: float) -> Section:
    deviation = 100.0 * (scale.robot_value[np.isfinite(scale.robot_value)] - 1.0)
    figure = set_style(make_subplots(), 'Against the tolerance of the data sheet', 380)
    count, edges = np.histogram(deviation, HISTOGRAM_BINS)
    figure.add_bar(
        x=0.5 * (edges[1:] + edges[:-1]),
        y=count,
        width=np.diff(edges),
        marker={'color': BLUE},
        name='robots',
        hovertemplate='%{y} robots at %{x:.2f} %',
    )
    for edge in (-100.0 * tolerance, 100.0 * tolerance):
        figure.add_vline(x=edge, line={'color': BEFORE.colour, 'dash': 'dash'})
    beyond = int((np.abs(deviation) > 100.0 * tolerance).sum())
    figure.update_xaxes(title_text='scale factor error (%)')
    figure.update_yaxes(title_text='robots')
    caption = (
        f'Dashed: the tolerance of {100 * tolerance:g} %. {beyond} of {len(deviation)} robots are beyond it.'
    )
    return Section('tolerance', figure, caption, half=True)


def _ageing(found: Findings, scale: FleetEstimate) -> Section:
    """Draw the change of each bag against its robot at zero age."""
    table = found.table
    used = table.calibrated
    age = age_h(table)[used] / 1000.0
    index = np.searchsorted(np.array(found.robots), np.array(table.columns['robot'], str)[used])
    change: Array = 100.0 * (table.numbers('scale_factor')[used] - scale.robot_value[index])
    shown = ~np.isin(index, scale.out_of_family) & np.isfinite(change)
    slope = scale.slopes[AGE]
    figure = set_style(make_subplots(), 'Ageing', 380)
    figure.add_scattergl(
        **xy(age[shown], change[shown]),
        mode='markers',
        name='bags',
        marker={'color': GREY, 'size': 4},
        hovertemplate='%{y:.3f} %',
    )
    ends = np.array([0.0, float(age.max())])
    line(figure, ends, 100.0 * slope.value * ends, 'mean', '.3f')
    for edge in (slope.low, slope.high):
        line(figure, ends, 100.0 * edge * ends, '95 %', '.3f', dash='dot')
    figure.data[-1].showlegend = False  # both limits have one entry
    figure.update_xaxes(title_text='age (1000 h)')
    figure.update_yaxes(title_text='change of the scale factor (%)')
    caption = (
        f'Every bag less its robot at zero age. Mean drift {100 * slope.value:+.4f} % in 1000 h, '
        f'95 % {100 * slope.low:+.4f} to {100 * slope.high:+.4f} %.'
    )
    return Section('ageing', figure, caption, half=True)


def _effects(found: Findings) -> Section:
    """Draw the sizes of the missing effects over the robots, in units of their mean."""
    figure = set_style(make_subplots(), 'Missing effects across the fleet', 380)
    for name, item in found.effects.items():
        values = item.robot_value[np.isfinite(item.robot_value)] / abs(item.mean.value)
        figure.add_box(y=values.astype(np.float32), name=name, boxpoints='outliers', marker={'color': BLUE})
    figure.update_yaxes(title_text='robot, relative to the fleet mean')
    caption = 'Coefficients of each robot, shrunk; a box holds half of the robots.'
    return Section('effects', figure, caption)
