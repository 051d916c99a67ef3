"""The page of `gyrocal bench growth`: time and memory against the size of the problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.report.html import Section, document, gallery
from gyrocal_ros.report.plot import GREY, STYLES, line, panels, points

COSTS = {'filter_s': 'filter alone', 'replay_cpu_s': 'whole replay'}
CAPTION = 'The dotted line is proportional growth. A whole replay includes about half a second of start-up.'


def growth_page(rows: Sequence[Mapping[str, Any]], about: str) -> str:
    """Return the page as HTML text.

    Args:
        rows: rows of the benchmark.
        about: version and machine.
    """
    sections = [
        section
        for against in dict.fromkeys(row['against'] for row in rows)
        for section in _sections([row for row in rows if row['against'] == against])
    ]
    return document('Growth of time and memory', about, [gallery(sections)])


def _sections(rows: Sequence[Mapping[str, Any]]) -> list[Section]:
    against, sizes = rows[0]['against'], [row['size'] for row in rows]
    place = against.partition(' (')[0].replace(' ', '_')
    times = {
        name: np.array([np.nan if row[cost] is None else row[cost] for row in rows], float)
        for cost, name in COSTS.items()
    }
    memory = {'whole replay': np.array([row['peak_mb'] for row in rows], float)}
    return [
        Section(f'time_{place}', _growth(against, sizes, times, 'processor time (s)'), CAPTION, half=True),
        Section(f'memory_{place}', _growth(against, sizes, memory, 'peak memory (MB)'), '', half=True),
    ]


def _growth(x_label: str, x: Sequence[float], lines: Mapping[str, Array], y_label: str) -> Any:
    """Draw a cost against a size, both on logarithmic axes."""
    figure = panels(y_label.partition(' (')[0].capitalize(), [y_label], 340)
    sizes = np.array(x)
    for style, (name, values) in zip(STYLES[1:], lines.items(), strict=False):
        points(figure, sizes, values, np.zeros(len(values)), name, '.3g', style, joined=True)
    first = next(iter(lines.values()))
    line(figure, sizes, first[0] * sizes / sizes[0], 'proportional', '.3g', colour=GREY, dash='dot')
    figure.update_xaxes(title_text=x_label, type='log', hoverformat='.4g', dtick=1)
    figure.update_yaxes(type='log', dtick=1)
    return figure
