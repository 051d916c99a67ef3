"""Calibrate on the bag that comes with the package, and show the result.

A simulated robot cleans a small room for 75 s, with images of the ceiling. The scale factor of its gyro is
wrong by several per cent; the report shows how the filter finds it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from gyrocal_ros.cli.output import print_json
from gyrocal_ros.cli.replay import as_text, replay
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.files import shipped

EXAMPLE = 'gyrocal demo\ngyrocal demo -o my_result'

DEFAULT_FOLDER = Path('gyrocal_demo')
"""Folder of the result without -o. It belongs to the demo, so a second run overwrites it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        '-o', '--out', type=Path, metavar='OUT', help=f'folder for the result ({DEFAULT_FOLDER})'
    )
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Replay the bag of the package."""
    out, config = args.out or DEFAULT_FOLDER, Config()
    summary = replay(
        shipped('bags/demo'),
        config,
        load_model(None),
        {'remap': {}, 'namespace': None, 'heading_reference': None},
        out=out,
        overwrite=args.overwrite or args.out is None,
    )
    if args.json:
        print_json(summary)
    else:
        print(as_text(summary))
        print(f'\nReport: {out / "report.html"}')
