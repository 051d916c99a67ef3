"""List the physical effects that a sensor model can be made of, or explain one of them.

The list includes your own effects: classes in a Python file given by --effects-from, or in an installed
package. docs/your_own_effect.md shows how to write one.
"""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import print_json
from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS, find_effect
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.describe import PLACES, effect_rows, place_of
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import write_text_atomic

EXAMPLE = """gyrocal effects
gyrocal effects gyro_lag
gyrocal effects gyro_lag -o gyro_lag.html
gyrocal effects my_effect --effects-from my_effects.py"""
MAX_WIDTH = 100
"""Maximum length of a line."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    complete_with(parser.add_argument('name', nargs='?', metavar='NAME', help='effect to explain'), EFFECTS)
    add_own_effects_option(parser)
    parser.add_argument(
        '-o', '--out', type=Path, metavar='FILE', help='write a page with a figure of the effect'
    )
    parser.add_argument('--overwrite', action='store_true', help='overwrite the page')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """List the effects, or explain one.

    Raises:
        GyrocalError: the effect does not exist, or the page cannot be written.
    """
    load_own_effects(args)
    if args.name is None:
        if args.out:
            raise GyrocalError('is for one effect', where='-o', todo='give its name')
        listed = [*EFFECTS.values(), *(make('SIGNAL') for make in COVARIATE_EFFECTS.values())]
        if args.json:
            print_json({'effects': [as_dict(effect) for effect in listed]})
        else:
            print('\n'.join(table(listed)))
        return
    name = f'{args.name}:SIGNAL' if args.name in COVARIATE_EFFECTS else args.name
    effect = find_effect(name)
    if args.out:
        from gyrocal_ros.report.effect import effect_page  # only a page needs the plotting library

        write_text_atomic(args.out, effect_page(effect), overwrite=args.overwrite)
    if args.json:
        print_json(as_dict(effect))
    else:
        print('\n'.join(explanation(effect)))
    if args.out and not args.json:
        print(f'\nPage: {args.out}')


def table(effects: list[LibraryEffect]) -> Iterator[str]:
    """Yield a table with one line for each effect."""
    rows = [('name', 'acts on', 'correction', 'usual size')]
    rows += [(item.name, place_of(item), item.about.equation, item.about.usual_size) for item in effects]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        yield '  '.join([*cells, row[-1]])


def explanation(effect: LibraryEffect) -> Iterator[str]:
    """Yield the complete description of an effect."""
    yield f'{effect.name}, {PLACES[place_of(effect)]}'
    yield ''
    yield from textwrap.wrap(effect.about.physics, MAX_WIDTH)
    yield ''
    for name, text in effect_rows(effect):
        yield from textwrap.wrap(text, MAX_WIDTH, initial_indent=f'{name:18}', subsequent_indent=18 * ' ')


def as_dict(effect: LibraryEffect) -> dict[str, Any]:
    """Return the description of an effect for `--json`."""
    about = effect.about
    return {
        'name': effect.name,
        'acts_on': place_of(effect),
        'physics': about.physics,
        'equation': about.equation,
        'usual_size': about.usual_size,
        'best_motion': about.best_motion,
        'twins': about.twins,
        'needs': about.needs,
        'source': about.source,
        'coefficients': [
            {
                'name': item.name,
                'unit': item.unit,
                'prior_mean': item.prior_mean,
                'prior_std': item.prior_std,
                'walk': item.walk,
                'example': example,
            }
            for item, example in zip(effect.coefficients, about.example, strict=True)
        ],
    }
