"""The options --png and --pdf of the commands that write a page."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.output import warn
from gyrocal_ros.errors import GyrocalError


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options to draw the figures as PNG and to print the page as PDF."""
    parser.add_argument(
        '--png', action='store_true', help='also draw the figures of the page as PNG, in OUT/figures'
    )
    parser.add_argument('--pdf', action='store_true', help='also print the page as OUT/report.pdf')


def check_pictures(args: argparse.Namespace) -> None:
    """Check before the work starts that figures can be drawn and pages printed, if that is requested.

    Raises:
        GyrocalError: there is no folder for them, or kaleido or a browser that works is missing.
    """
    for is_requested, option, what in ((args.png, '--png', 'pictures'), (args.pdf, '--pdf', 'report')):
        if is_requested and args.out is None:
            raise GyrocalError(f'needs a folder for the {what}', where=option, todo='give one with -o')
    # Only a page needs the plotting library.
    if args.png:
        from gyrocal_ros.report.png import try_png

        try_png()
    if args.pdf:
        from gyrocal_ros.report.pdf import find_browser

        find_browser()


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


def print_if_requested(is_requested: bool, folder: Path) -> None:
    """Print `report.html` as `report.pdf`; a failure is only a warning, because the results are there.

    Args:
        is_requested: True if the page is to be printed.
        folder: folder of the page.
    """
    if not is_requested:
        return
    from gyrocal_ros.report.pdf import save_pdf  # only a page needs the plotting library

    try:
        save_pdf(folder / 'report.html', folder / 'report.pdf')
    except GyrocalError as error:
        warn(str(error))
