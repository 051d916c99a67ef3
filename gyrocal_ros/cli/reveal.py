"""Open the sealed answer of a simulated bag: the hidden effects and their sizes.

`gyrocal simulate OUT --hidden` writes the bag, and the answer beside it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.output import print_json
from gyrocal_ros.effects.base import with_unit
from gyrocal_ros.sim.sealed import unseal

EXAMPLE = """gyrocal simulate my_bag --hidden --seed 7
gyrocal reveal my_bag"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of the bag')
    parser.add_argument('--json', action='store_true', help='one JSON object in place of the text')


def run(args: argparse.Namespace) -> None:
    """Print the answer.

    Raises:
        RecordingError: there is none, or it belongs to another bag.
    """
    answer = unseal(args.bag)
    if args.json:
        print_json(answer)
    else:
        print('\n'.join(as_text(answer)))


def as_text(answer: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sealed answer in lines of text."""
    if 'fleet' in answer:
        for name, value in answer['fleet'].items():
            text = ', '.join(map(str, value)) if isinstance(value, list) else value
            yield f'{name:18} {text if text not in ("", None) else "none"}'
        return
    bias = answer['bias']
    start, end = math.degrees(bias['start']), math.degrees(bias['end'])
    yield f'{answer["scenario"]}, seed {answer["seed"]}, {answer["duration_s"]:g} s'
    yield f'scale factor  {answer["scale_factor"]:.6f}'
    yield f'bias          {start:+.5f} deg/s at the start, {end:+.5f} deg/s at the end'
    if not answer['effects']:
        yield 'hidden        nothing'
    for effect in answer['effects']:
        values = effect['coefficients'].items()
        text = ', '.join(f'{name} = {with_unit(item["value"], item["unit"])}' for name, item in values)
        yield f'hidden        {effect["effect"]}: {text}'
