"""Writes a bag of a simulated robot: all topics that a real one records, and the ground truth."""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from gyrocal_ros.cli.output import progress
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.recording.write import new_bag
from gyrocal_ros.sim.scenarios import SCENARIOS, find_scenario
from gyrocal_ros.sim.world import SimSource

EXAMPLE = """gyrocal simulate my_bag --scenario furniture --seed 7 --duration 120
gyrocal simulate my_images --duration 60 --images"""

MAX_DURATION_S = 2 * 3600.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `gyrocal simulate`."""
    scenarios = '; '.join(f'{name}: {scenario.about}' for name, scenario in SCENARIOS.items())
    parser.add_argument('out', metavar='OUT', type=Path, help='folder of the bag to write')
    parser.add_argument('--scenario', default='cleaning', metavar='NAME', help=f'{scenarios} (%(default)s)')
    parser.add_argument('--seed', type=int, default=0, metavar='N', help='same seed, same bag (%(default)s)')
    parser.add_argument('--duration', type=float, metavar='S', help="length in seconds (the scenario's own)")
    parser.add_argument('--images', action='store_true', help='images of the ceiling, not tracked features')
    parser.add_argument(
        '--jpeg-quality', type=int, default=80, metavar='Q', help='of the images, 1 to 100 (%(default)s)'
    )
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='kind of the file (%(default)s)'
    )
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')


def run(args: argparse.Namespace) -> None:
    """Write the bag and say what is in it.

    Raises:
        GyrocalError: an argument is out of bounds, or the bag cannot be written.
    """
    source = _source(args)
    span, counts = source.span, Counter[str]()
    with new_bag(args.out, args.storage, overwrite=args.overwrite, jpeg_quality=args.jpeg_quality) as bag:
        bag.write_rig(source.rig, span.start_ns, R_bi=np.eye(3))
        by_second = groupby(source.measurements(), key=lambda item: item.t_ns // NS_PER_S)
        for _, measured in progress('simulating', by_second, total=math.ceil(span.duration_s), unit='s'):
            for measurement in measured:
                bag.write(measurement)
                counts[type(measurement).__name__] += 1
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    camera = f'{counts["Frame"]} images' if args.images else f'{counts["FeatureObservations"]} feature lists'
    print(
        f'{args.out}: {source.scenario.name}, seed {source.seed}, {span.duration_s:g} s, '
        f'{counts["ImuSample"]} IMU samples, {camera}, {size_mb:.1f} MB'
    )


def _source(args: argparse.Namespace) -> SimSource:
    scenario = find_scenario(args.scenario)
    duration_s = scenario.duration_s if args.duration is None else args.duration
    _check('--duration', duration_s, 1.0, MAX_DURATION_S, 's')
    _check('--seed', args.seed, 0, math.inf)
    _check('--jpeg-quality', args.jpeg_quality, 1, 100)
    return SimSource(replace(scenario, duration_s=duration_s), args.seed, images=args.images)


def _check(option: str, value: float, low: float, high: float, unit: str = '') -> None:
    if not low <= value <= high:
        bounds = f'at least {low:g}' if math.isinf(high) else f'{low:g} to {high:g}'
        raise GyrocalError(f'is {value:g}', where=option, todo=f'give {bounds} {unit}'.rstrip())
