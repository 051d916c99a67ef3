"""Reproduce the figures and the table of the paper, and report which of its claims hold.

Lee, Choi, Park, Myung 2012, Self-calibration of Gyro using Monocular SLAM for an Indoor Mobile Robot,
International Journal of Control, Automation, and Systems 10(3). All data come from the simulator and the
estimator of this package; the seeds are 0, 1, 2 and so on, and the same seeds give the same figures.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.bench.paper.catalogue import EXPERIMENTS, PaperResult
from gyrocal_ros.cli.numbers import whole_number
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import print_json, print_message, progress
from gyrocal_ros.cli.provenance import provenance
from gyrocal_ros.errors import GyrocalError, did_you_mean
from gyrocal_ros.files import json_text, new_folder, write_text_atomic

EXAMPLE = """gyrocal reproduce
gyrocal reproduce fig14 fig15 -o landmarks
gyrocal reproduce table1 --seeds 20 --json"""

T = TypeVar('T')
R = TypeVar('R')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    names = parser.add_argument(
        'names', nargs='*', metavar='NAME', help=f'figure or table: {", ".join(EXPERIMENTS)} (all)'
    )
    complete_with(names, EXPERIMENTS)
    parser.add_argument(
        '--seeds',
        type=whole_number(1),
        metavar='N',
        help='number of runs of each, in place of its usual number',
    )
    parser.add_argument('-o', '--out', type=Path, metavar='OUT', help='folder for the page and the numbers')
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Reproduce the requested figures, and print the comparison with the paper.

    Raises:
        GyrocalError: a name is not known, or the folder may not be written.
    """
    names = _names(args.names)
    with new_folder(args.out, overwrite=args.overwrite) if args.out else nullcontext() as folder:
        results = {name: _reproduce(name, args.seeds, to_text=not args.json) for name in names}
        document = _document(results, args.seeds)
        if folder is not None:
            from gyrocal_ros.cli.reproduce_page import page  # only a page needs the plotting library

            write_text_atomic(folder / 'reproduced.json', json_text(document))
            write_text_atomic(folder / 'report.html', page(results))
    if args.json:
        print_json(document)
    elif args.out:
        print(f'\nReport: {args.out / "report.html"}')


def _names(requested: Sequence[str]) -> list[str]:
    for name in requested:
        if name not in EXPERIMENTS:
            todo = did_you_mean(name, list(EXPERIMENTS))
            raise GyrocalError('is not a figure or table of the paper', where=repr(name), todo=todo)
    return [name for name in EXPERIMENTS if name in requested or not requested]


def _reproduce(name: str, seeds: int | None, to_text: bool) -> PaperResult:
    experiment = EXPERIMENTS[name]
    print_message(f'{experiment.title} ...')

    def each(function: Callable[[T], R], tasks: Sequence[T], /) -> Iterable[R]:
        return progress(name, in_parallel(function, tasks), total=len(tasks), unit='run')

    result = experiment.make(each, experiment.count(seeds))
    if to_text:
        _print(experiment.title, result)
    return result


def _print(title: str, result: PaperResult) -> None:
    print(title)
    for claim in result.claims:
        print(f'  {claim.what}: {claim.verdict}')
        print(f'    paper: {claim.paper}')
        print(f'    here:  {claim.here}', flush=True)


def _document(results: dict[str, PaperResult], seeds: int | None) -> dict[str, Any]:
    return provenance() | {
        'results': {
            name: {'title': EXPERIMENTS[name].title, 'seeds': EXPERIMENTS[name].count(seeds)} | asdict(result)  # type: ignore[call-overload]
            for name, result in results.items()
        }
    }
