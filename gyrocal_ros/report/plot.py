"""Elements that all figures share: colours, panels, lines, bands, points with error bars.

Only this module, `png` and the modules of the products know plotly. The colours are of the palette of
Okabe and Ito. Lines differ in their dashes as well, so figures can be read in grey, and no colour is black
or white, so they can be read on light and on dark.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any, TypeVar

import numpy as np
import plotly.graph_objects as go
from plotly.io import to_html
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.series.run_series import rows_to_draw

BLUE, VERMILLION, GREEN, PURPLE, GREY = '#0072B2', '#D55E00', '#009E73', '#CC79A7', '#808080'
GRID, CLEAR = 'rgba(128,128,128,0.25)', 'rgba(0,0,0,0)'
_AXIS = {'gridcolor': GRID, 'linecolor': GRID, 'zeroline': False, 'showline': True, 'automargin': True}
TEMPLATE = go.layout.Template(
    layout={
        'title': {'x': 0.0, 'y': 1.0, 'yanchor': 'top', 'pad': {'t': 12}, 'font': {'size': 18}},
        'margin': {'l': 70, 'r': 15, 't': 80, 'b': 55},
        'font': {'family': 'system-ui, sans-serif', 'size': 13, 'color': GREY},
        'paper_bgcolor': CLEAR,
        'plot_bgcolor': CLEAR,
        'legend': {'orientation': 'h', 'x': 0.0, 'y': 1.0, 'yanchor': 'bottom', 'bgcolor': CLEAR},
        'hoverlabel': {'bgcolor': '#22262e', 'font': {'color': '#f2f2f2'}},
        'modebar': {'bgcolor': CLEAR, 'color': GREY, 'activecolor': BLUE},
        'xaxis': {**_AXIS, 'hoverformat': '.1f', 'title': {'standoff': 8}},
        'yaxis': {**_AXIS, 'exponentformat': 'none'},
    }
)
"""Fonts, margins and axes that all figures share."""
TIME = 'time since the first sample (s)'
MAX_POINTS = 1500
"""Maximum number of points of a line, about; more do not show on a screen."""
SIGMAS = 3.0
"""Half width of bands and error bars in standard deviations."""
Panel = tuple[int, int]
"""Row and column of a panel."""
FIRST: Panel = (1, 1)

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class LineStyle:
    """Colour, marker and dash of one of several things that are compared."""

    colour: str
    symbol: str
    dash: str


BEFORE, AFTER = LineStyle(VERMILLION, 'x', 'dot'), LineStyle(GREEN, 'circle', 'solid')
STYLES = (
    BEFORE,
    AFTER,
    LineStyle(BLUE, 'square', 'dash'),
    LineStyle(PURPLE, 'diamond', 'dashdot'),
    LineStyle('#E69F00', 'triangle-up', 'longdash'),
    LineStyle('#56B4E9', 'star', 'longdashdot'),
)
"""Styles of models side by side; a seventh one has the style of the first."""


def styled(models: Mapping[str, T]) -> Iterator[tuple[str, T, LineStyle]]:
    """Yield name, value and style of each of several models."""
    for style, (name, value) in zip(cycle(STYLES), models.items(), strict=False):
        yield name, value, style


def panels(title: str, y_titles: list[str], row_px: int = 230) -> go.Figure:
    """Make panels one above the other over a common time axis."""
    count = len(y_titles)
    figure = make_subplots(rows=count, cols=1, shared_xaxes=True, vertical_spacing=0.12 / count)
    set_style(figure, title, 130 + row_px * count)
    figure.layout.hovermode = 'x unified'
    *_, lowest = figure.select_xaxes()
    lowest.title.text = TIME
    for axis, text in zip(figure.select_yaxes(), y_titles, strict=True):
        axis.title.text = text
    return figure


def floor_plan(title: str) -> go.Figure:
    """Make an empty view from above, to scale."""
    figure = set_style(go.Figure(), title, 560)
    figure.update_xaxes(title_text='x (m)')
    figure.update_yaxes(title_text='y (m)', scaleanchor='x')
    return figure


def set_style(figure: go.Figure, title: str, height_px: int) -> go.Figure:
    """Set title, height, fonts, margins and axes of a figure."""
    figure.update_layout(template=TEMPLATE, title={'text': title}, height=height_px)
    return figure


def show_range(figure: go.Figure, panel: Panel, values: Array, margin: float = 0.08) -> None:
    """Set the range of a panel to that of the values."""
    low, high = float(values.min()), float(values.max())
    pad = margin * (high - low) or 1e-9
    figure.update_yaxes(range=[low - pad, high + pad], row=panel[0], col=panel[1])


def set_log_range(figure: go.Figure, panel: Panel, low: float, high: float) -> None:
    """Give a panel a logarithmic axis with this range."""
    bounds = [math.log10(low), math.log10(high)]
    figure.update_yaxes(type='log', dtick=1, range=bounds, row=panel[0], col=panel[1])


def xy(x: Array, y: Array) -> dict[str, Any]:
    """Return coordinates in single precision, which halves the page and is far finer than a screen."""
    return {'x': x.astype(np.float32), 'y': y.astype(np.float32)}


def kept_rows(*columns: Array) -> IntArray:
    """Select the rows to draw of columns (n,) that are longer than a screen is wide."""
    return rows_to_draw(np.stack(columns, axis=1), MAX_POINTS)


def line(
    figure: go.Figure,
    x: Array,
    y: Array,
    name: str,
    digits: str,
    panel: Panel = FIRST,
    colour: str = BLUE,
    dash: str = 'solid',
) -> None:
    """Add a line to a panel."""
    figure.add_scatter(
        **xy(x, y),
        name=name,
        legendgroup=name,
        mode='lines',
        line={'color': colour, 'width': 2, 'dash': dash},
        hovertemplate=f'%{{y:{digits}}}',
        row=panel[0],
        col=panel[1],
    )


def band(
    figure: go.Figure,
    x: Array,
    middle: Array,
    reach: Array,
    panel: Panel = FIRST,
    name: str = '3 sigma',
) -> None:
    """Add a band around `middle`, interrupted at gaps of `x`."""
    steps = np.diff(x)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > max(0.01 * x[-1], 5.0 * usual)) + 1
    upper, lower = (np.split(np.stack([x, edge]), gaps, axis=1) for edge in (middle + reach, middle - reach))
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
        row=panel[0],
        col=panel[1],
    )


def points(
    figure: go.Figure,
    x: Array,
    y: Array,
    reach: Array,
    name: str,
    digits: str,
    style: LineStyle,
    panel: Panel = FIRST,
    joined: bool = False,
) -> None:
    """Add points with their error bars to a panel.

    Args:
        figure: figure to add to.
        x: (n,)
        y: (n,)
        reach: (n,) to both sides, or (2, n) down and up.
        name: name in the legend, which shows it once for all panels.
        digits: format of a value.
        style: colour, symbol and dash.
        panel: the panel.
        joined: draw a line through the points.
    """
    down, up = np.broadcast_to(reach, (2, len(y))).astype(np.float32)
    figure.add_scatter(
        **xy(x, y),
        name=name,
        legendgroup=name,
        showlegend=all(trace.name != name for trace in figure.data),
        mode='lines+markers' if joined else 'markers',
        line={'color': style.colour, 'width': 1.5, 'dash': style.dash},
        marker={'symbol': style.symbol, 'size': 8, 'color': style.colour},
        error_y={
            'type': 'data',
            'array': up,
            'arrayminus': down,
            'color': style.colour,
            'thickness': 1.3,
            'width': 4,
        },
        customdata=np.stack([y - down, y + up], axis=1).astype(np.float32),
        hovertemplate=f'%{{y:{digits}}} (%{{customdata[0]:{digits}}} to %{{customdata[1]:{digits}}})',
        row=panel[0],
        col=panel[1],
    )


def to_fragment(figure: go.Figure, name: str) -> str:
    """Return the figure as a piece of HTML; the page must contain `plotly_js()` once before it."""
    html: str = to_html(
        figure, full_html=False, include_plotlyjs=False, div_id=name, config=plot_config(name)
    )
    return html


def plot_config(name: str) -> dict[str, Any]:
    """Return the configuration of a figure in a browser; `name` is the file name of its saved picture.

    Nothing in it uses the network: plotly's button that uploads a figure is disabled.
    """
    return {
        'responsive': True,
        'displaylogo': False,
        'showSendToCloud': False,
        'plotlyServerURL': '',
        'modeBarButtonsToRemove': ['select2d', 'lasso2d'],
        'toImageButtonOptions': {'filename': name},
    }


def plotly_js() -> str:
    """Return the source of plotly.js, to be embedded in a page that needs no internet."""
    script: str = get_plotlyjs()
    return script
