"""Measure accuracy, consistency and speed on simulated robots whose truth is known."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

from gyrocal_ros.bench.accuracy import accuracy
from gyrocal_ros.bench.blind import blind
from gyrocal_ros.bench.camera_off import camera_off
from gyrocal_ros.bench.motions import motions
from gyrocal_ros.bench.speed import speed
from gyrocal_ros.bench.tracker import tracker_accuracy
from gyrocal_ros.cli.output import print_json, print_row, progress
from gyrocal_ros.cli.provenance import provenance

EXAMPLE = """gyrocal bench accuracy --seeds 20
gyrocal bench blind --seeds 10 --only none scale_cubic
gyrocal bench speed"""

BENCHES: dict[str, Callable[[argparse.Namespace], Iterator[dict[str, Any]]]] = {
    'accuracy': lambda args: accuracy(args.seeds, args.quick),
    'blind': lambda args: blind(args.seeds, args.only),
    'camera_off': lambda args: camera_off(args.seeds),
    'tracker': lambda args: tracker_accuracy(args.seeds),
    'motions': lambda args: motions(),
    'speed': lambda args: speed(args.quick),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('what', choices=BENCHES, help='what to measure')
    parser.add_argument('--seeds', type=int, default=20, help='recordings a case (default 20)')
    parser.add_argument('--quick', action='store_true', help='the first case only')
    parser.add_argument('--only', nargs='+', default=[], metavar='CASE', help='of `blind`: these cases only')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the tables')


def run(args: argparse.Namespace) -> None:
    """Measure, and print each row as it becomes ready."""
    rows = []
    for row in progress(f'bench {args.what}', BENCHES[args.what](args), unit='case'):
        rows.append(row)
        if not args.json:
            print_row(row, header=len(rows) == 1)
    if args.json:
        print_json({'bench': args.what, **provenance(), 'seeds': args.seeds, 'rows': rows})
