"""Writes a bag of a simulated robot: all topics that a real one records, and the ground truth.

With `--effect` the robot has a physical effect that the usual sensor model lacks (`gyrocal effects`
lists them); with `--hidden` the seed decides which, or none, and the answer is sealed beside the bag.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.output import progress
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.base import LibraryEffect, with_unit
from gyrocal_ros.errors import ConfigError, GyrocalError
from gyrocal_ros.model.sensor import RelativeEffect
from gyrocal_ros.recording.write import new_bag
from gyrocal_ros.settings import nearest
from gyrocal_ros.sim.hidden import Drawn, draw_hidden, draw_scale_factor, hide
from gyrocal_ros.sim.scenarios import SCENARIOS, find_scenario
from gyrocal_ros.sim.sealed import answer_of, seal, sealed_path
from gyrocal_ros.sim.strangers import STRANGERS
from gyrocal_ros.sim.world import SimSource

EXAMPLE = """gyrocal simulate my_bag --scenario furniture --seed 7 --duration 120
gyrocal simulate my_images --duration 60 --images
gyrocal simulate slow_gyro --effect gyro_lag=0.02 --effect bias_warmup=amplitude:0.01,time_constant:200
gyrocal simulate riddle --hidden --seed 7"""

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
    secret = parser.add_mutually_exclusive_group()
    secret.add_argument(
        '--effect',
        action='append',
        default=[],
        metavar='NAME[=VALUE,...]',
        help="give the robot a physical effect; values in the effect library's units, without them "
        'a usual size; may be repeated',
    )
    secret.add_argument(
        '--hidden', action='store_true', help='hide what the seed decides; `gyrocal reveal OUT` tells it'
    )
    add_own_effects_option(parser)
    parser.add_argument(
        '--storage', choices=('mcap', 'sqlite3'), default='mcap', help='kind of the file (%(default)s)'
    )
    parser.add_argument('--overwrite', action='store_true', help='write into a folder that is not empty')


def run(args: argparse.Namespace) -> None:
    """Write the bag and say what is in it.

    Raises:
        GyrocalError: an argument is out of bounds, or the bag cannot be written.
    """
    load_own_effects(args)
    source = _source(args)
    sealed = sealed_path(args.out)
    if args.hidden and sealed.exists() and not args.overwrite:
        raise GyrocalError('exists already', where=str(sealed), todo='choose another name or --overwrite')
    span, counts = source.span, Counter[str]()
    with new_bag(args.out, args.storage, overwrite=args.overwrite, jpeg_quality=args.jpeg_quality) as bag:
        bag.write_rig(source.rig, span.start_ns, R_bi=np.eye(3))
        by_second = groupby(source.measurements(), key=lambda item: item.t_ns // NS_PER_S)
        for _, measured in progress('simulating', by_second, total=math.ceil(span.duration_s), unit='s'):
            for measurement in measured:
                bag.write(measurement)
                counts[type(measurement).__name__] += 1
    if args.hidden:
        seal(args.out, answer_of(source), overwrite=args.overwrite)
    size_mb = sum(file.stat().st_size for file in args.out.iterdir()) / 1e6
    camera = f'{counts["Frame"]} images' if args.images else f'{counts["FeatureObservations"]} feature lists'
    print(
        f'{args.out}: {source.scenario.name}, seed {source.seed}, {span.duration_s:g} s, '
        f'{counts["ImuSample"]} IMU samples, {camera}, {size_mb:.1f} MB'
    )
    if args.hidden:
        print(f'what it hides: gyrocal reveal {args.out}')
    for item in () if args.hidden else source.hidden:
        named = zip(item.effect.coefficients, item.values, strict=True)
        values = ', '.join(f'{about.name} = {with_unit(value, about.unit)}' for about, value in named)
        print(f'with {item.effect.name}: {values}')


def _source(args: argparse.Namespace) -> SimSource:
    scenario = find_scenario(args.scenario)
    duration_s = scenario.duration_s if args.duration is None else args.duration
    _check('--duration', duration_s, 1.0, MAX_DURATION_S, 's')
    _check('--seed', args.seed, 0, math.inf)
    _check('--jpeg-quality', args.jpeg_quality, 1, 100)
    drawn = [parse_effect(text) for text in args.effect]
    scale_factor = scenario.errors.scale_factor
    if args.hidden:
        drawn, scale_factor = [*draw_hidden(args.seed, duration_s)], draw_scale_factor(args.seed)
    for item in (item for item in drawn if item.name == 'scale_factor'):
        scale_factor = 1.0 + item.values[0]
    hidden = hide([item for item in drawn if item.name != 'scale_factor'], find_effect)
    errors = replace(scenario.errors, scale_factor=scale_factor)
    scenario = replace(scenario, duration_s=duration_s, errors=errors)
    return SimSource(scenario, args.seed, images=args.images, hidden=hidden)


def parse_effect(text: str) -> Drawn:
    """Read `NAME`, `NAME=VALUE,VALUE` or `NAME=coefficient:value,...`.

    Raises:
        ConfigError: the effect or a coefficient is not known, or a value is no number.
    """
    name, has_values, given = text.partition('=')
    effect = STRANGERS.get(name) or find_effect(name, '--effect')
    if not has_values:
        if isinstance(effect, LibraryEffect) and not isinstance(effect, RelativeEffect):
            return Drawn(name, effect.about.example)
        raise ConfigError('has no usual size', where=f'--effect {name}', todo=f'give it, as in {name}=VALUE')
    parts = given.split(',')
    if all(':' in part for part in parts):
        named = dict(part.split(':', 1) for part in parts)
        known = [item.name for item in effect.coefficients]
        for one in named:
            if one not in known:
                todo = nearest(one, known)
                raise ConfigError(f'{name} has no coefficient {one!r}', where='--effect', todo=todo)
        parts = [named.get(item.name, f'{item.prior_mean}') for item in effect.coefficients]
    try:
        values = tuple(map(float, parts))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise ConfigError(f'{given!r} is not a list of numbers', where=f'--effect {name}', todo='see --help')
    return Drawn(name, values)


def _check(option: str, value: float, low: float, high: float, unit: str = '') -> None:
    if not low <= value <= high:
        bounds = f'at least {low:g}' if math.isinf(high) else f'{low:g} to {high:g}'
        raise GyrocalError(f'is {value:g}', where=option, todo=f'give {bounds} {unit}'.rstrip())
