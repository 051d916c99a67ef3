"""Calibrate many bags of many robots, and ask how much the gyros differ, what they lack, which one is faulty.

`run` works on all bags with Dask, on this machine or on a cluster, and continues where it was interrupted.
`report` estimates means, part-to-part spread, ageing and missing effects, and writes a page. `prior` writes
what the next robot should assume before its first turn. `compare` compares two fleets.
"""

from __future__ import annotations

import argparse
import os
from importlib.util import find_spec
from pathlib import Path

from gyrocal_ros.cli import fleet_report
from gyrocal_ros.cli.model_options import add_model_options, read_model
from gyrocal_ros.cli.numbers import whole_number
from gyrocal_ros.cli.options import add_images_option, add_topic_options, bag_options, read_config
from gyrocal_ros.cli.output import print_json, print_message, progress
from gyrocal_ros.errors import GyrocalError, RecordingError

EXAMPLE = """gyrocal fleet run recordings/ -o my_fleet
gyrocal fleet run bags.csv -o my_fleet --scheduler tcp://10.0.0.5:8786
gyrocal fleet report my_fleet
gyrocal fleet prior my_fleet -o prior.yaml
gyrocal fleet compare before after"""

EXTRA = ('dask', 'distributed', 'pyarrow', 'fsspec')
"""Libraries of the extra."""
SCHEDULER = 'DASK_SCHEDULER_ADDRESS'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    commands = parser.add_subparsers(metavar='WHAT', required=True, dest='what')
    run_parser = commands.add_parser('run', help='calibrate and diagnose every bag')
    run_parser.add_argument(
        'bags',
        nargs='+',
        metavar='BAGS',
        help='folders, bags, patterns or tables (CSV, Parquet); paths or URLs',
    )
    run_parser.add_argument(
        '-o',
        '--out',
        type=Path,
        required=True,
        metavar='FLEET',
        help='folder of the results; continued if it exists',
    )
    run_parser.add_argument(
        '--scheduler', metavar='ADDRESS', help=f'a running Dask scheduler, as tcp://host:8786 (${SCHEDULER})'
    )
    run_parser.add_argument(
        '--workers', type=whole_number(1), metavar='N', help='number of local workers (one per core)'
    )
    run_parser.add_argument(
        '--dashboard-port',
        type=whole_number(0, 65535),
        default=0,
        metavar='PORT',
        help='port of the local Dask dashboard, on the loopback interface (any free one)',
    )
    add_topic_options(run_parser)
    add_model_options(run_parser)
    add_images_option(run_parser)
    run_parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')
    fleet_report.add_parsers(commands)


def run(args: argparse.Namespace) -> None:
    """Run one of the commands on fleets.

    Raises:
        GyrocalError: the extra is not installed, or the command fails.
    """
    require_extra()
    if args.what == 'run':
        _run(args)
    else:
        fleet_report.run(args)


def require_extra() -> None:
    """Raise an error if a library of the extra is not installed."""
    missing = [name for name in EXTRA if find_spec(name) is None]
    if missing:
        todo = "pip install 'gyrocal_ros[fleet]'"
        raise GyrocalError(f'needs {", ".join(missing)}', where='gyrocal fleet', todo=todo)


def _run(args: argparse.Namespace) -> None:
    # Dask and Arrow are loaded only for work on fleets.
    from gyrocal_ros.fleet.engine import cluster, run_fleet
    from gyrocal_ros.fleet.plan import plan_bags
    from gyrocal_ros.fleet.result import CALIBRATED, BagResult
    from gyrocal_ros.fleet.store import FleetStore
    from gyrocal_ros.fleet.work import job_of

    effects_from = str(args.effects_from.resolve()) if args.effects_from else None
    job = job_of(read_config(args), read_model(args), effects_from=effects_from, **bag_options(args))
    planned = plan_bags(args.bags)
    store = FleetStore(args.out)
    scheduler = args.scheduler or os.environ.get(SCHEDULER)
    failures = 0
    with (
        cluster(scheduler, args.workers, args.dashboard_port) as client,
        progress('fleet', total=len(planned), unit='bag') as bar,
    ):
        print_message(f'{len(planned)} bags; Dask dashboard: {client.dashboard_link}')

        def report(result: BagResult) -> None:
            nonlocal failures
            failures += result.row['status'] != CALIBRATED
            bar.set_postfix_str(f'{failures} failed', refresh=False)
            bar.update()

        done = run_fleet(planned, job, store, client, report)
    if args.json:
        print_json(
            {
                'fleet': str(args.out),
                'bags': done.bags,
                'calibrated': done.calibrated,
                'failed': done.failed,
                'resumed': done.resumed,
                'workers': done.workers,
                'wall_s': done.wall_s,
                'work_s': done.work_s,
            }
        )
    else:
        print(f'{args.out}: {done.calibrated} of {done.bags} bags calibrated, {done.failed} failed')
        print(f'next: gyrocal fleet report {args.out}')
    if not done.calibrated:
        raise RecordingError(
            'no bag could be calibrated from',
            where=str(args.out),
            todo='see the reasons in calibrations.parquet',
        )
