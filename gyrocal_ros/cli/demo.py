"""Calibrate on the bag that comes with the package, and show the result.

A simulated robot cleans a small room for little more than a minute and films the ceiling on the way.
Its gyro turns out to be off by several per cent; the report shows how that was found.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gyrocal_ros.cli.output import print_json
from gyrocal_ros.cli.replay import replay, verdict
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.files import shipped

EXAMPLE = 'gyrocal demo\ngyrocal demo -o my_result'

OWN_FOLDER = Path('gyrocal_demo')
"""Where the result goes unless told otherwise; it is the demo's own, so a second run replaces it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('-o', '--out', type=Path, metavar='OUT', help=f'folder for the result ({OWN_FOLDER})')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Replay the packaged bag."""
    out, config = args.out or OWN_FOLDER, Config()
    summary = replay(
        shipped('bags/demo'),
        config,
        load_model(None),
        {'remap': {}, 'namespace': None, 'heading_reference': None},
        out=out,
        overwrite=args.out is None,
    )
    if args.json:
        print_json(summary)
    else:
        print(verdict(summary, config))
        print(f'\nReport: {out / "report.html"}')
