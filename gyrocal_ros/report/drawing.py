"""What all figures have in common; with the figures the one place that knows plotly.

Colours are of the palette of Okabe and Ito; lines differ in their dashes as well, so that a figure
can be read in grey, and none needs black or white, so that it can be read on light and on dark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gyrocal_ros.data import Array

BLUE, VERMILLION, GREEN, PURPLE, GREY = '#0072B2', '#D55E00', '#009E73', '#CC79A7', '#808080'
GRID, CLEAR = 'rgba(128,128,128,0.25)', 'rgba(0,0,0,0)'
TIME = 'time since the first sample (s)'
Place = tuple[int, int]
"""Row and column of a panel."""


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
