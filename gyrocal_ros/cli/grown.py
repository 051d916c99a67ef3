"""The page of `gyrocal bench growth`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrocal_ros.cli.provenance import provenance
from gyrocal_ros.report.figures.paper import growth
from gyrocal_ros.report.html import Section, document, gallery

COSTS = {'filter_s': 'filter alone', 'replay_cpu_s': 'whole replay'}
CAPTION = 'The dotted line is growth in proportion. A whole replay begins with about a second of start-up.'


def growth_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Time and memory against each size, as HTML text."""
    about = provenance()
    sections = [
        section
        for against in dict.fromkeys(row['against'] for row in rows)
        for section in _sections([row for row in rows if row['against'] == against])
    ]
    return document(
        'How time and memory grow', f'gyrocal {about["version"]}, {about["machine"]}', [gallery(sections)]
    )


def _sections(rows: Sequence[Mapping[str, Any]]) -> list[Section]:
    against, sizes = rows[0]['against'], [row['size'] for row in rows]
    place = against.partition(' (')[0].replace(' ', '_')
    times = {
        name: np.array([np.nan if row[cost] is None else row[cost] for row in rows], float)
        for cost, name in COSTS.items()
    }
    memory = {'whole replay': np.array([row['peak_mb'] for row in rows], float)}
    return [
        Section(f'time_{place}', growth(against, sizes, times, 'processor time (s)'), CAPTION, half=True),
        Section(f'memory_{place}', growth(against, sizes, memory, 'peak memory (MB)'), '', half=True),
    ]
