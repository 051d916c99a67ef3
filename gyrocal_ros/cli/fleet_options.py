"""The simulated fleets of `gyrocal simulate --fleet`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.cli.numbers import whole_number
from gyrocal_ros.cli.output import progress
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import new_folder, write_text_atomic
from gyrocal_ros.sim.fleet import FleetBag, draw_fleet, draw_law
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sealed import seal, sealed_path

TABLE = 'fleet.csv'
"""The table of the bags."""
DEFAULT_BAGS, DEFAULT_DURATION_S = 3, 60.0


def add_fleet_options(parser: argparse.ArgumentParser) -> None:
    """Declare the size of a fleet."""
    parser.add_argument(
        '--fleet', type=whole_number(2, 10_000), metavar='ROBOTS', help='write the bags of many robots'
    )
    parser.add_argument(
        '--bags', type=whole_number(1, 1000), metavar='N', help=f'with --fleet: bags of each ({DEFAULT_BAGS})'
    )


def simulate_fleet(args: argparse.Namespace) -> None:
    """Write the bags of a fleet, the table of them, and the sealed answer.

    Raises:
        GyrocalError: an option does not apply to fleets, or OUT cannot be written.
    """
    if not args.fleet:
        raise GyrocalError('is for fleets', where='--bags', todo='give --fleet ROBOTS as well')
    for option in ('effect', 'hidden', 'images', 'effects_from'):
        if getattr(args, option):
            raise GyrocalError(
                'is for single bags', where=f'--{option.replace("_", "-")}', todo='leave it out'
            )
    if sealed_path(args.out).exists() and not args.overwrite:
        todo = 'choose another name or --overwrite'
        raise GyrocalError('exists already', where=str(sealed_path(args.out)), todo=todo)
    duration_s = args.duration or DEFAULT_DURATION_S
    law = draw_law(args.seed, duration_s)
    scenario = find_scenario(args.scenario)
    count = args.bags or DEFAULT_BAGS
    fleet = draw_fleet(law, args.seed, args.fleet, count, scenario, duration_s)
    with new_folder(args.out, overwrite=args.overwrite) as folder:
        for bag in progress('simulating', fleet.bags, unit='bag'):
            write_bag(folder / bag.name, bag, args.storage)
        write_text_atomic(folder / TABLE, fleet_table(fleet.bags))
    seal(args.out, fleet.answer(), overwrite=args.overwrite)
    print(f'{args.out}: {args.fleet} robots, {len(fleet.bags)} bags of {duration_s:g} s, seed {args.seed}')
    print(f'next: gyrocal fleet run {args.out / TABLE} -o {args.out}_results')
    print(f'to see how they were drawn: gyrocal reveal {args.out}')


def write_bag(path: Path, bag: FleetBag, storage: str = 'mcap') -> None:
    """Write one bag of a simulated fleet."""
    source = bag.source()
    with new_bag(path, storage) as written:  # type: ignore[arg-type]
        written.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
        for measurement in source.measurements():
            written.write(measurement)


def fleet_table(bags: tuple[FleetBag, ...]) -> str:
    """Return the table of the bags, with time and running hours, as CSV."""
    rows = (f'{bag.name},{bag.robot},{bag.time},{bag.age_h:g}' for bag in bags)
    return '\n'.join(['bag,robot,time,age_h', *rows, ''])
