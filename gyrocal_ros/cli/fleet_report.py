"""The commands on finished fleets: `fleet report`, `fleet prior` and `fleet compare`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyrocal_ros.cli.numbers import number
from gyrocal_ros.cli.options import add_config_option, read_config
from gyrocal_ros.cli.output import print_json, table
from gyrocal_ros.errors import GyrocalError, did_you_mean
from gyrocal_ros.files import write_text_atomic
from gyrocal_ros.report.describe import quantity, with_std

if TYPE_CHECKING:
    from gyrocal_ros.fleet.comparison import Difference
    from gyrocal_ros.fleet.findings import Findings

PAGE = 'report.html'


def add_parsers(commands: Any) -> None:
    """Declare the commands and their arguments."""
    report = commands.add_parser('report', help='spread, ageing, faulty robots, missing effects; with a page')
    report.add_argument('fleets', nargs='+', type=Path, metavar='FLEET', help='folders of `fleet run`')
    report.add_argument(
        '--tolerance',
        type=number(1e-6, 100.0, 'per cent'),
        default=3.0,
        metavar='PERCENT',
        help='tolerance of the scale factor by the data sheet, for the page (%(default)s)',
    )
    report.add_argument(
        '--page', type=Path, metavar='FILE', help=f'the page ({PAGE} in the first FLEET, replaced)'
    )
    _add_json(report)
    prior = commands.add_parser('prior', help='what the next robot should assume before its first turn')
    prior.add_argument('fleets', nargs='+', type=Path, metavar='FLEET', help='folders of `fleet run`')
    prior.add_argument('-o', '--out', type=Path, required=True, metavar='FILE', help='file for --start-from')
    prior.add_argument(
        '--leave-out', metavar='ROBOT', help='leave out this robot, to test the prior on its bags'
    )
    prior.add_argument('--overwrite', action='store_true', help='replace an existing file')
    add_config_option(prior)
    _add_json(prior)
    compare = commands.add_parser('compare', help='difference of two fleets, with intervals')
    compare.add_argument('first', type=Path, metavar='A', help='folder of a fleet')
    compare.add_argument('second', type=Path, metavar='B', help='folder of another one')
    _add_json(compare)


def run(args: argparse.Namespace) -> None:
    """Run one of the commands.

    Raises:
        GyrocalError: a fleet cannot be read, or is too small.
    """
    {'report': _report, 'prior': _prior, 'compare': _compare}[args.what](args)


def _report(args: argparse.Namespace) -> None:
    # Dask and Arrow are loaded only for work on fleets, the plotting library only for a page.
    from gyrocal_ros.fleet.findings import find
    from gyrocal_ros.fleet.summary import summarise_fleet
    from gyrocal_ros.fleet.table import read_fleet
    from gyrocal_ros.report.fleet import fleet_page

    found = find(read_fleet(args.fleets))
    page = args.page or args.fleets[0] / PAGE
    write_text_atomic(page, fleet_page(found, args.tolerance / 100.0), overwrite=True)
    if args.json:
        print_json(summarise_fleet(found))
        return
    print('\n'.join(as_text(found)))
    print(f'\nReport: {page}')


def as_text(found: Findings) -> Iterator[str]:
    """Yield the findings in lines of text."""
    from gyrocal_ros.fleet.findings import advice

    good, count = int(found.table.calibrated.sum()), len(found.table)
    yield f'{good} of {count} bags of {len(found.robots)} robots are calibrated.'
    if found.left_out:
        yield f'{found.left_out} of them have not converged and do not count below.'
    if found.coefficients:
        yield ''
        yield from table(
            ('coefficient', 'fleet mean', 'part-to-part spread', '95 %', 'bag to bag', 'robots'),
            [
                (
                    name,
                    with_std(item.mean.value, item.mean.std),
                    f'{item.spread.value:.3g}',
                    f'{item.spread.low:.2g} to {item.spread.high:.2g}',
                    f'{item.bag_spread:.2g}',
                    str(item.robots),
                )
                for name, item in (found.coefficients | found.effects).items()
            ],
        )
    for name, item in found.coefficients.items():
        for regressor, slope in item.slopes.items():
            yield (
                f'{name} per {regressor}: {slope.value:+.2g}, 95 % {slope.low:+.2g} to {slope.high:+.2g}'
                f' ({slope.sigma:.1f} sigma)'
            )
    yield ''
    yield from _missing(found)
    for robot, by in found.out_of_family.items():
        yield f'Out of family: {robot}, ' + ', '.join(f'{name} {z:+.1f} sigma' for name, z in by.items())
    for effect in found.robot_effects:
        value = quantity(effect.value, effect.value / effect.sigma, effect.unit)
        yield f'{effect.robot} alone has {effect.effect}: {value} ({effect.sigma:.1f} sigma)'
    steps = advice(found)
    if steps:
        yield ''
        yield 'Next:'
        yield from (f'  {step}' for step in steps)


def _missing(found: Findings) -> Iterator[str]:
    for item in found.pooled.found:
        columns = zip(item.names, item.values.tolist(), item.stds.tolist(), item.units, strict=True)
        values = ', '.join(f'{name} = {quantity(value, std, unit)}' for name, value, std, unit in columns)
        yield (
            f'The fleet lacks {item.effect}: {values} ({item.sigma:.1f} sigma in {found.pooled.bags} bags, '
            f'{item.per_bag_sigma:.1f} in one)'
        )
        if item.confused_with:
            yield f'  not distinguishable from {", ".join(item.confused_with)}'
        if item.separated_from:
            others = ', '.join(item.separated_from)
            yield f'  distinguished from {others} by all bags together, not by one'
    if found.pooled.strongest is not None:
        best = found.pooled.strongest
        yield (
            f'No effect is missing in the fleet; the strongest is {best.effect}, {best.sigma:.1f} sigma in '
            f'{found.pooled.bags} bags, {best.per_bag_sigma:.1f} in one.'
        )


def _prior(args: argparse.Namespace) -> None:
    from gyrocal_ros.fleet.findings import find
    from gyrocal_ros.fleet.prior import prior_of
    from gyrocal_ros.fleet.table import read_fleet, without_robot
    from gyrocal_ros.pipeline.calibration import coefficient_table, save_calibration

    config, fleet = read_config(args), read_fleet(args.fleets)
    if args.leave_out:
        robots = sorted(set(fleet.columns['robot']))
        if args.leave_out not in robots:
            todo = did_you_mean(args.leave_out, robots)
            raise GyrocalError(f'there is no robot {args.leave_out!r}', where='--leave-out', todo=todo)
        fleet = without_robot(fleet, args.leave_out)
    prior = prior_of(find(fleet), config)
    save_calibration(prior, config, args.out, overwrite=args.overwrite)
    coefficients = coefficient_table(prior)
    if args.json:
        print_json({'source': prior.source, 'coefficients': coefficients})
        return
    print(f'{args.out}: {prior.source}')
    for name, entry in coefficients.items():
        print(f'{name:16} {quantity(entry["value"], entry["std"], entry["unit"])}')
    print(f'next: gyrocal replay BAG --start-from {args.out}')


def _compare(args: argparse.Namespace) -> None:
    from gyrocal_ros.fleet.comparison import compare
    from gyrocal_ros.fleet.findings import find
    from gyrocal_ros.fleet.summary import summarise_difference
    from gyrocal_ros.fleet.table import read_fleet

    first, second = find(read_fleet([args.first])), find(read_fleet([args.second]))
    differences = compare(first, second)
    if not differences:
        todo = 'run both with the same model, on three robots or more'
        raise GyrocalError('have no coefficient in common', where=f'{args.first}, {args.second}', todo=todo)
    if args.json:
        print_json({'differences': [summarise_difference(item) for item in differences]})
        return
    print(f'{args.second} less {args.first}')
    print('\n'.join(table(('coefficient', 'difference', '95 %', 'sigma', 'spread'), _rows(differences))))


def _rows(differences: list[Difference]) -> list[tuple[str, ...]]:
    return [
        (
            item.name,
            f'{item.mean.value:+.3g}',
            f'{item.mean.low:+.3g} to {item.mean.high:+.3g}',
            f'{item.mean.sigma:.1f}',
            f'x {item.spread_ratio.value:.2f} ({item.spread_ratio.low:.2f} to {item.spread_ratio.high:.2f})'
            if math.isfinite(item.spread_ratio.value)
            else '-',
        )
        for item in differences
    ]


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')
