"""The option of the commands that write a page: its figures as PNG too."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.output import warn
from gyrocal_ros.errors import GyrocalError


def add_png_option(parser: argparse.ArgumentParser) -> None:
    """Declare that pictures are wanted."""
    parser.add_argument(
        '--png', action='store_true', help='draw the figures of the page as PNG too, into OUT/figures'
    )


def draw_if_wanted(is_wanted: bool, folder: Path, sections: Iterable[Any]) -> None:
    """Draw the figures of a page; where this machine cannot, say so and go on.

    Args:
        is_wanted: whether to draw at all.
        folder: with the page.
        sections: of the page, as the report has them.
    """
    if not is_wanted:
        return
    from gyrocal_ros.report.write import draw_figures  # only a page needs the plotting library

    try:
        draw_figures(folder, sections)
    except GyrocalError as error:
        warn(str(error))
