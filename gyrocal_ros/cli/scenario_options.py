"""Options that describe a simulated robot, and the source of its measurements."""

from __future__ import annotations

import argparse
from dataclasses import replace

from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.numbers import number, whole_number
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.quantities import coefficient_value
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.model.sensor import Effect, RelativeEffect
from gyrocal_ros.sim.hidden import (
    UNKNOWN_TO_THE_LIBRARY,
    DrawnEffect,
    draw_hidden,
    draw_scale_factor,
    hide,
)
from gyrocal_ros.sim.scenarios import SCENARIOS, Scenario
from gyrocal_ros.sim.world import SimSource

MAX_DURATION_S = 2 * 3600.0
"""Maximum length of a simulated recording."""


def add_scenario_options(parser: argparse.ArgumentParser) -> argparse._MutuallyExclusiveGroup:
    """Declare scenario, seed, length and the effects of the robot.

    Returns:
        The group of `--effect`, for options that exclude it.
    """
    scenarios = '; '.join(f'{name}: {scenario.about}' for name, scenario in SCENARIOS.items())
    scenario = parser.add_argument(
        '--scenario', default='cleaning', metavar='NAME', help=f'{scenarios} (%(default)s)'
    )
    complete_with(scenario, SCENARIOS)
    parser.add_argument(
        '--seed',
        type=whole_number(0),
        default=0,
        metavar='N',
        help='seed of all random numbers (%(default)s)',
    )
    parser.add_argument(
        '--duration',
        type=number(1.0, MAX_DURATION_S, 's'),
        metavar='S',
        help='length in seconds (that of the scenario)',
    )
    effects = parser.add_mutually_exclusive_group()
    effect = effects.add_argument(
        '--effect',
        action='append',
        default=[],
        metavar='NAME[=VALUE,...]',
        help='give the robot a physical effect, with values in the units of `gyrocal effects` or, without '
        'values, of a usual size; may be repeated',
    )
    complete_with(effect, EFFECTS)
    add_own_effects_option(parser)
    return effects


def scenario_source(
    args: argparse.Namespace, scenario: Scenario, *, images: bool = False, hidden: bool = False
) -> SimSource:
    """Return the simulated robot that the options describe.

    Args:
        args: with the options of `add_scenario_options`.
        scenario: the scenario that the length and the effects are applied to.
        images: render images of the ceiling in place of tracked features.
        hidden: draw the effects of the robot by the seed.

    Raises:
        GyrocalError: an option is unknown or out of bounds.
    """
    load_own_effects(args)
    duration_s = scenario.duration_s if args.duration is None else args.duration
    drawn = [parse_effect(text) for text in args.effect]
    scale_factor = scenario.errors.scale_factor
    if hidden:
        drawn, scale_factor = [*draw_hidden(args.seed, duration_s)], draw_scale_factor(args.seed)
    for item in (item for item in drawn if item.name == 'scale_factor'):
        scale_factor = 1.0 + item.values[0]
    effects = hide([item for item in drawn if item.name != 'scale_factor'], find_effect)
    errors = replace(scenario.errors, scale_factor=scale_factor)
    scenario = replace(scenario, duration_s=duration_s, errors=errors)
    return SimSource(scenario, args.seed, images=images, hidden=effects)


def parse_effect(text: str) -> DrawnEffect:
    """Read `NAME`, `NAME=VALUE,VALUE` or `NAME=coefficient:value,...`.

    Raises:
        ConfigError: the effect or a coefficient is not known, or a value is not a number.
    """
    name, has_values, given = text.partition('=')
    effect: Effect = UNKNOWN_TO_THE_LIBRARY.get(name) or find_effect(name, '--effect')
    if not has_values:
        if isinstance(effect, LibraryEffect) and not isinstance(effect, RelativeEffect):
            return DrawnEffect(name, effect.about.example)
        raise ConfigError('has no usual size', where=f'--effect {name}', todo=f'give it, as in {name}=VALUE')
    parts = given.split(',')
    if all(':' in part for part in parts):
        named = dict(part.split(':', 1) for part in parts)
        known = [item.name for item in effect.coefficients]
        for one in named:
            if one not in known:
                todo = did_you_mean(one, known)
                raise ConfigError(f'{name} has no coefficient {one!r}', where='--effect', todo=todo)
        parts = [named.get(item.name, f'{item.prior_mean}') for item in effect.coefficients]
    if len(parts) != len(effect.coefficients):
        names = ','.join(f'{item.name}:VALUE' for item in effect.coefficients)
        raise ConfigError(f'{given!r} has {len(parts)} values', where='--effect', todo=f'give {name}={names}')
    pairs = zip(effect.coefficients, parts, strict=True)
    return DrawnEffect(name, tuple(coefficient_value(item, part, f'--effect {name}') for item, part in pairs))
