"""Report the contents of a bag and its problems: topics, rates, gaps, stamps, units, mounting, turns.

The exit status is 2 where the bag cannot be used for a calibration.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from gyrocal_ros.bag.check import CheckReport, RawMessages, TopicSummary, check_bag
from gyrocal_ros.cli.options import add_bag_options, bag_options, read_config
from gyrocal_ros.cli.output import print_json, progress
from gyrocal_ros.errors import RecordingError

EXAMPLE = 'gyrocal check my_bag\ngyrocal check my_bag -r imu/data_raw:=/imu/data --heading-reference /odom'

COLUMNS = ('topic', 'type', 'used as', 'messages', 'Hz', 'from s', 'to s', 'longest gap s')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_bag_options(parser)
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Check the bag and print the report."""

    def shown(messages: RawMessages, count: int) -> RawMessages:
        return progress('checking', messages, total=count, unit=' messages')

    report = check_bag(args.bag, read_config(args), shown, **bag_options(args))
    if args.json:
        values = asdict(report)
        values['findings'] = values.pop('issues')
        print_json({**values, 'usable': report.usable})
    else:
        print('\n'.join(_text(report)))
    if not report.usable:
        raise RecordingError(
            'this bag cannot be used for a calibration', where=report.name, todo='mend the errors above'
        )


def _text(report: CheckReport) -> Iterator[str]:
    yield f'{report.name}: {report.duration_s:.1f} s'
    yield ''
    yield from _table([COLUMNS, *map(_row, report.topics)])
    yield ''
    for issue in report.issues:
        yield f'{issue.severity}: {issue}'
    if report.usable:
        yield 'This bag can be used for a calibration.'


def _row(topic: TopicSummary) -> tuple[str, ...]:
    figures = (
        f'{topic.rate_hz:.4g}',
        f'{topic.start_s:.1f}',
        f'{topic.end_s:.1f}',
        f'{topic.longest_gap_s:.2g}',
    )
    shown = ('' if text == 'nan' else text for text in figures)
    return topic.name, topic.type_name, topic.role, str(topic.count), *shown


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            text.ljust(width) if place < 3 else text.rjust(width)
            for place, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield '  '.join(cells).rstrip()
