"""The page on which the paper's figures stand beside what this package makes of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gyrocal_ros import __version__
from gyrocal_ros.report.html import HANDLING, Section, document, gallery, table

HEADS = ('claim', 'in the paper', 'here', 'verdict')
ABOUT = (
    'Lee, Choi, Park, Myung 2012, Self-calibration of Gyro using Monocular SLAM for an Indoor Mobile Robot, '
    f'made anew with the simulator and the estimator of gyrocal {__version__}. {HANDLING}'
)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One figure or table of the paper."""

    title: str
    rows: Sequence[tuple[str, str, str, str]]
    """What is claimed, the paper's number, the number here, and whether it holds."""
    sections: Sequence[Section]


def paper_page(parts: Iterable[Part]) -> str:
    """The whole page as HTML text."""
    pieces = [
        piece
        for part in parts
        for piece in (table(part.title, HEADS, part.rows, words=True), gallery(part.sections, note=''))
    ]
    return document('The paper, made anew', ABOUT, pieces)
