"""What all figures have in common; with the figures the one place that knows plotly.

Colours are of the palette of Okabe and Ito; lines differ in their dashes as well, so that a figure
can be read in grey, and none needs black or white, so that it can be read on light and on dark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.io import to_html
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.report import series

BLUE, VERMILLION, GREEN, PURPLE, GREY = '#0072B2', '#D55E00', '#009E73', '#CC79A7', '#808080'
GRID, CLEAR = 'rgba(128,128,128,0.25)', 'rgba(0,0,0,0)'
TIME = 'time since the first sample (s)'
POINTS = 1500
"""A line is drawn through no more points than this."""
SIGMAS = 3.0
Place = tuple[int, int]
"""Row and column of a panel."""


@dataclass(frozen=True, slots=True)
class LineStyle:
    """How one of several things that are compared is drawn everywhere."""

    colour: str
    symbol: str
    dash: str


BEFORE, AFTER = LineStyle(VERMILLION, 'x', 'dot'), LineStyle(GREEN, 'circle', 'solid')
LOOKS = (
    BEFORE,
    AFTER,
    LineStyle(BLUE, 'square', 'dash'),
    LineStyle(PURPLE, 'diamond', 'dashdot'),
    LineStyle('#E69F00', 'triangle-up', 'longdash'),
    LineStyle('#56B4E9', 'star', 'longdashdot'),
)
"""For several models side by side; a seventh looks like the first."""


def curves(title: str, x_label: str, y_label: str, x: Array, lines: Mapping[str, Array]) -> go.Figure:
    """Some curves over one axis."""
    figure = panels(title, [y_label], 320)
    styles = ((BLUE, 'solid'), (VERMILLION, 'dash'), (GREEN, 'dot'))
    for (name, value), (colour, dash) in zip(lines.items(), styles, strict=False):
        line(figure, x, value, name, '.4g', (1, 1), colour, dash)
    figure.update_xaxes(title_text=x_label, hoverformat='.4g')
    return figure


def panels(title: str, titles: list[str], row_px: int = 230) -> go.Figure:
    """Panels one above the other over a common time axis."""
    count = len(titles)
    figure = make_subplots(rows=count, cols=1, shared_xaxes=True, vertical_spacing=0.12 / count)
    dress(figure, title, 130 + row_px * count)
    figure.update_layout(hovermode='x unified')
    figure.update_xaxes(title_text=TIME, row=count, col=1)
    for row, text in enumerate(titles, start=1):
        figure.update_yaxes(title_text=text, row=row, col=1)
    return figure


def floor_plan(title: str) -> go.Figure:
    """A view from above, to scale."""
    figure = dress(go.Figure(), title, 560)
    figure.update_xaxes(title_text='x (m)')
    figure.update_yaxes(title_text='y (m)', scaleanchor='x')
    return figure


def dress(figure: go.Figure, title: str, height_px: int) -> go.Figure:
    """Give a figure its title, height and looks."""
    figure.update_layout(
        template='none',
        title={'text': title, 'x': 0.0, 'y': 1.0, 'yanchor': 'top', 'pad': {'t': 12}, 'font': {'size': 18}},
        height=height_px,
        margin={'l': 70, 'r': 15, 't': 80, 'b': 55},
        font={'family': 'system-ui, sans-serif', 'size': 13, 'color': GREY},
        paper_bgcolor=CLEAR,
        plot_bgcolor=CLEAR,
        legend={'orientation': 'h', 'x': 0.0, 'y': 1.0, 'yanchor': 'bottom', 'bgcolor': CLEAR},
        hoverlabel={'bgcolor': '#22262e', 'font': {'color': '#f2f2f2'}},
        modebar={'bgcolor': CLEAR, 'color': GREY, 'activecolor': BLUE},
    )
    axis = {'gridcolor': GRID, 'linecolor': GRID, 'zeroline': False, 'showline': True, 'automargin': True}
    figure.update_xaxes(**axis, hoverformat='.1f', title_standoff=8)
    figure.update_yaxes(**axis, exponentformat='none')
    return figure


def line(
    figure: go.Figure,
    time_s: Array,
    value: Array,
    name: str,
    digits: str,
    place: Place,
    colour: str = BLUE,
    dash: str = 'solid',
) -> None:
    """Add a line to a panel."""
    figure.add_scatter(
        **xy(time_s, value),
        name=name,
        legendgroup=name,
        mode='lines',
        line={'color': colour, 'width': 2, 'dash': dash},
        hovertemplate=f'%{{y:{digits}}}',
        row=place[0],
        col=place[1],
    )


def show(figure: go.Figure, place: Place, values: Array, margin: float = 0.08) -> None:
    """Let a panel show the range of the values."""
    low, high = float(values.min()), float(values.max())
    pad = margin * (high - low) or 1e-9
    figure.update_yaxes(range=[low - pad, high + pad], row=place[0], col=place[1])


def logarithmic(figure: go.Figure, place: Place, low: float, high: float) -> None:
    """Give a panel a logarithmic axis."""
    bounds = [math.log10(low), math.log10(high)]
    figure.update_yaxes(type='log', dtick=1, range=bounds, row=place[0], col=place[1])


def xy(x: Array, y: Array) -> dict[str, Any]:
    """Single precision: half the size of the page, and far finer than a screen."""
    return {'x': x.astype(np.float32), 'y': y.astype(np.float32)}


def band(
    figure: go.Figure, time_s: Array, middle: Array, reach: Array, place: Place, name: str = '3 sigma'
) -> None:
    """A band around `middle`, broken where nothing is told for a while."""
    steps_s = np.diff(time_s)
    usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    gaps = np.flatnonzero(steps_s > max(0.01 * time_s[-1], 5.0 * usual_s)) + 1
    upper, lower = (
        np.split(np.stack([time_s, edge]), gaps, axis=1) for edge in (middle + reach, middle - reach)
    )
    apart = np.full((2, 1), np.nan)
    outlines = [
        part for there, back in zip(upper, lower, strict=True) for part in (there, back[:, ::-1], apart)
    ]
    figure.add_scatter(
        **xy(*np.concatenate(outlines, axis=1)),
        name=name,
        legendgroup=name,
        showlegend=all(trace.name != name for trace in figure.data),
        fill='toself',
        fillcolor='rgba(0,114,178,0.18)',
        line={'color': 'rgba(0,114,178,0.45)', 'width': 1},
        hoverinfo='skip',
        row=place[0],
        col=place[1],
    )


def kept(*columns: Array) -> IntArray:
    """Which rows to draw of columns (n,) that are longer than a screen is wide."""
    return series.kept(np.stack(columns, axis=1), POINTS)


def fragment(figure: go.Figure, name: str) -> str:
    """The figure as a piece of HTML; the page must hold `library()` once before it."""
    html: str = to_html(figure, full_html=False, include_plotlyjs=False, div_id=name, config=handling(name))
    return html


def handling(name: str) -> dict[str, Any]:
    """How a figure may be handled in a browser, the name being that of its picture when it is saved.

    Nothing in it reaches for the network: plotly's button that uploads a figure is left out.
    """
    return {
        'responsive': True,
        'displaylogo': False,
        'showSendToCloud': False,
        'plotlyServerURL': '',
        'modeBarButtonsToRemove': ['select2d', 'lasso2d'],
        'toImageButtonOptions': {'filename': name},
    }


def library() -> str:
    """The source of plotly.js, to stand inside a page that needs no internet."""
    script: str = get_plotlyjs()
    return script


def points(
    figure: go.Figure,
    x: Array,
    y: Array,
    reach: Array,
    name: str,
    digits: str,
    place: Place,
    look: LineStyle,
    joined: bool = False,
) -> None:
    """Add points with their error bars to a panel.

    Args:
        figure: to add to.
        x: (n,)
        y: (n,)
        reach: (n,) to both sides, or (2, n) down and up.
        name: in the legend, once however many panels it stands in.
        digits: how to write a value.
        place: the panel.
        look: colour and symbol.
        joined: draw a line through the points.
    """
    down, up = np.broadcast_to(reach, (2, len(y))).astype(np.float32)
    figure.add_scatter(
        **xy(x, y),
        name=name,
        legendgroup=name,
        showlegend=all(trace.name != name for trace in figure.data),
        mode='lines+markers' if joined else 'markers',
        line={'color': look.colour, 'width': 1.5, 'dash': look.dash},
        marker={'symbol': look.symbol, 'size': 8, 'color': look.colour},
        error_y={
            'type': 'data',
            'array': up,
            'arrayminus': down,
            'color': look.colour,
            'thickness': 1.3,
            'width': 4,
        },
        customdata=np.stack([y - down, y + up], axis=1).astype(np.float32),
        hovertemplate=f'%{{y:{digits}}} (%{{customdata[0]:{digits}}} to %{{customdata[1]:{digits}}})',
        row=place[0],
        col=place[1],
    )
