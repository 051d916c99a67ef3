"""Write a bag of a simulated robot, with all topics that a real robot records and the ground truth.

With `--effect` the robot has a physical effect that the default sensor model lacks (`gyrocal effects`
lists them). With `--hidden` the effects are drawn by the seed, possibly none, and the answer is written to
a sealed file beside the bag. With `--fleet` there are many robots, with bags of each and a table of all;
means, spread, ageing, a common effect and faulty robots are drawn by the seed and sealed.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from itertools import groupby
from pathlib import Path

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.cli.fleet_options import add_fleet_options, simulate_fleet
from gyrocal_ros.cli.image_options import add_image_options, with_image_options
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import progress
from gyrocal_ros.cli.scenario_options import add_scenario_options, scenario_source
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.effects.base import with_unit
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.sim.references import KINDS, ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sealed import answer_of, seal, sealed_path

EXAMPLE = """gyrocal simulate my_bag --scenario furniture --seed 7 --duration 120
gyrocal simulate my_images --duration 60 --images
gyrocal simulate my_beams --duration 60 --images --ceiling beams --condition readout_s=0.02
gyrocal simulate my_fisheye --duration 60 --images --scene fisheye
gyrocal simulate slow_gyro --effect gyro_lag=0.02 --effect bias_warmup=amplitude:0.01,time_constant:200
gyrocal simulate exercise --hidden --seed 7
gyrocal simulate my_lidar --reference lidar --duration 180
gyrocal simulate robots --fleet 40 --bags 3 --duration 60 --seed 1"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('out', metavar='OUT', type=Path, help='folder of the bag to write')
    add_scenario_options(parser).add_argument(
        '--hidden',
        action='store_true',
        help='hide effects drawn by the seed; `gyrocal reveal OUT` shows them',
    )
    reference = parser.add_argument(
        '--reference',
        metavar='KIND',
        help='record a heading reference in place of the ceiling camera, with noise, drift, offset, gaps and '
        'jumps by the seed: ' + '; '.join(f'{name}: {kind.about}' for name, kind in KINDS.items()),
    )
    complete_with(reference, KINDS)
    add_fleet_options(parser)
    add_image_options(parser)
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='storage format (%(default)s)'
    )
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')


def run(args: argparse.Namespace) -> None:
    """Write the bag and print its contents.

    Raises:
        GyrocalError: an argument is out of bounds, or the bag cannot be written.
    """
    if args.fleet or args.bags:
        simulate_fleet(args)
        return
    scenario = with_image_options(args, find_scenario(args.scenario))
    robot = scenario_source(args, scenario, images=args.images, hidden=args.hidden)
    if args.reference and args.images:
        raise GyrocalError('excludes --images', where='--reference', todo='give one of them')
    source = ReferenceSource(robot, args.reference) if args.reference else robot
    sealed = sealed_path(args.out)
    if args.hidden and sealed.exists() and not args.overwrite:
        raise GyrocalError('exists already', where=str(sealed), todo='choose another name or --overwrite')
    quality = scenario.image_conditions.jpeg_quality
    span, counts = source.span, Counter[str]()
    with new_bag(args.out, args.storage, overwrite=args.overwrite, jpeg_quality=quality) as bag:
        bag.write_rig(source.rig, span.start_ns, R_bi=np.eye(3))
        by_second = groupby(source.measurements(), key=lambda item: item.t_ns // NS_PER_S)
        for _, measured in progress('simulating', by_second, total=math.ceil(span.duration_s), unit='s'):
            for measurement in measured:
                bag.write(measurement)
                counts[type(measurement).__name__] += 1
    if args.hidden:
        seal(args.out, answer_of(robot), overwrite=args.overwrite)
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    camera = f'{counts["Frame"]} images' if args.images else f'{counts["FeatureObservations"]} feature lists'
    if args.reference:
        camera = f'{counts["HeadingSample"]} headings'
    print(
        f'{args.out}: {robot.scenario.name}, seed {robot.seed}, {span.duration_s:g} s, '
        f'{counts["ImuSample"]} IMU samples, {camera}, {size_mb:.1f} MB'
    )
    if args.hidden:
        print(f'to see the hidden effects: gyrocal reveal {args.out}')
    for item in () if args.hidden else robot.hidden:
        pairs = zip(item.effect.coefficients, item.values, strict=True)
        values = ', '.join(f'{about.name} = {with_unit(value, about.unit)}' for about, value in pairs)
        print(f'with {item.effect.name}: {values}')
