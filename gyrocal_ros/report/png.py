"""Figures as PNG pictures for papers and slides, drawn by a Chromium or Chrome of this machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import plotly.graph_objects as go

from gyrocal_ros.errors import GyrocalError

WIDTH_PX = 1100
SCALE = 2
"""Number of picture pixels for a pixel of the figure."""
REMEDY = (
    "`pip install 'kaleido>=1'` and install Chromium; or omit --png: every figure of report.html has a "
    'button that saves it'
)


def try_png() -> None:
    """Draw an empty figure and discard it.

    Raises:
        GyrocalError: kaleido is missing, or this machine has no browser that it can use.
    """
    with TemporaryDirectory() as folder:
        save_png({'empty': go.Figure(layout_height=100)}, Path(folder))


def save_png(figures: Mapping[str, go.Figure], folder: Path) -> None:
    """Draw figures into a folder, `NAME.png` each, on white.

    Raises:
        GyrocalError: kaleido is missing, or this machine has no browser that it can use.
    """
    if find_spec('kaleido') is None:
        raise GyrocalError('figures cannot be drawn as PNG: kaleido is missing', todo=REMEDY)
    import kaleido

    try:
        # Without mathjax, which it would load from the network.
        kaleido.write_fig_from_object_sync(
            [*_orders(figures, folder)], cancel_on_error=True, kopts={'mathjax': False}
        )
    except Exception as error:  # whatever a browser that does not start may raise
        raise GyrocalError(f'figures cannot be drawn as PNG ({_first_line(error)})', todo=REMEDY) from error


def _orders(figures: Mapping[str, go.Figure], folder: Path) -> Iterator[dict[str, Any]]:
    for name, figure in figures.items():
        on_white = go.Figure(figure).update_layout(paper_bgcolor='white', plot_bgcolor='white')
        size = {'width': WIDTH_PX, 'height': figure.layout.height, 'scale': SCALE}
        yield {'fig': on_white, 'path': str(folder / f'{name}.png'), 'opts': {'format': 'png', **size}}


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
