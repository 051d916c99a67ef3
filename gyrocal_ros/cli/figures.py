"""The option --png of the commands that write a page."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.output import warn
from gyrocal_ros.errors import GyrocalError


def add_png_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option to draw the figures as PNG."""
    parser.add_argument(
        '--png', action='store_true', help='also draw the figures of the page as PNG, in OUT/figures'
    )


def check_png(args: argparse.Namespace) -> None:
    """Check before the work starts that the figures can be drawn, if they are requested.

    Raises:
        GyrocalError: there is no folder for them, or kaleido or a browser that works is missing.
    """
    if not args.png:
        return
    if args.out is None:
        raise GyrocalError('needs a folder for the pictures', where='--png', todo='give one with -o')
    from gyrocal_ros.report.png import try_png  # only a page needs the plotting library

    try_png()


def draw_if_requested(is_requested: bool, folder: Path, sections: Iterable[Any]) -> None:
    """Draw the figures of a page as PNG; a failure is only a warning, because the results are there.

    Args:
        is_requested: True if the figures are to be drawn.
        folder: folder of the page.
        sections: sections of the page.
    """
    if not is_requested:
        return
    from gyrocal_ros.report.write import draw_figures  # only a page needs the plotting library

    try:
        draw_figures(folder, sections)
    except GyrocalError as error:
        warn(str(error))
