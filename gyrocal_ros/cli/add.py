"""Add a physical effect to a sensor model, model.yaml.

From then on the filter estimates its coefficients, in replay and on the robot. If the model does not
exist, the effect is added to a copy of the default one. Otherwise one entry is added to the file, and its
comments and everything else are kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.cli.options import complete_with
from gyrocal_ros.cli.output import print_message
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.effects.model_file import load_model, options_of, with_entry
from gyrocal_ros.effects.quantities import coefficient_prior
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.files import shipped, write_text_atomic

EXAMPLE = """gyrocal add gyro_lag --model model.yaml
gyrocal add covariate_bias:battery_state.current --model model.yaml -o heavier.yaml
gyrocal add rate_saturation --set limit=60deg/s --model model.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    complete_with(
        parser.add_argument('effect', metavar='EFFECT', help='name of the effect, see `gyrocal effects`'),
        EFFECTS,
    )
    parser.add_argument(
        '--model',
        type=Path,
        metavar='FILE',
        default=Path('model.yaml'),
        help='model to add it to (%(default)s)',
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='prior of a coefficient, as in k=-0.57deg/s or k=-0.57+-0.02deg/s, or an option of the effect; '
        'may be repeated',
    )
    add_own_effects_option(parser)
    parser.add_argument('-o', '--out', type=Path, metavar='FILE', help='file to write (the model itself)')
    parser.add_argument('--overwrite', action='store_true', help='overwrite the file given by -o')


def run(args: argparse.Namespace) -> None:
    """Add the effect, and print the effects of the new model.

    Raises:
        ConfigError: the effect does not exist, or the model cannot be used.
    """
    load_own_effects(args)
    entry = model_entry(args.effect, args.set)
    start = args.model if args.model.exists() else shipped('config/model.yaml')
    names = [effect.name for effect in load_model(start).effects]
    text, out = start.read_text(encoding='utf-8'), args.out or args.model
    if args.effect in names:
        print(f'{start}: has {args.effect} already, which is left unchanged')
    else:
        text = with_entry(text, entry, str(start))
        names.append(args.effect)
        _tell_reference(args.effect, entry)
    write_text_atomic(out, text, overwrite=args.overwrite or args.out is None)
    print(f'{out}: {", ".join(names)}')


def _tell_reference(name: str, entry: str | Mapping[str, Any]) -> None:
    """Tell where a signal is counted from, unless that was given: bias and scale factor are those there."""
    effect = find_effect(name)
    if 'reference' in options_of(effect) and (isinstance(entry, str) or 'reference' not in entry):
        signal = getattr(effect, 'signal', name)
        print_message(
            f'{signal} counts from 0, so that bias and scale factor are those at 0: give its mean as '
            '--set reference=VALUE; `gyrocal diagnose` tells it'
        )


def model_entry(name: str, settings: Sequence[str]) -> str | Mapping[str, Any]:
    """Return the entry of an effect in `model.yaml`, with its settings.

    Args:
        name: name of the effect.
        settings: NAME=VALUE, where NAME is a coefficient or an option of the effect. The value of a
            coefficient may have a standard deviation, that of its prior. Without a unit it is in the unit
            of the coefficient.

    Raises:
        ConfigError: the effect does not exist, or a setting is not known or has an impossible value.
    """
    effect = find_effect(name)
    coefficients = {item.name: item for item in effect.coefficients}
    known = options_of(effect)
    means: dict[str, float] = {}
    stds: dict[str, float] = {}
    options: dict[str, float | str] = {}
    for setting in settings:
        key, equals, text = (part.strip() for part in setting.partition('='))
        if not equals:
            raise ConfigError(f'is {setting!r}', where='--set', todo='write it as NAME=VALUE')
        if key in coefficients:
            means[key], std = coefficient_prior(coefficients[key], text, '--set')
            if std is not None:
                stds[key] = std
        elif key in known:
            options[key] = _number_or_text(text)
        else:
            todo = did_you_mean(key, [*coefficients, *known])
            raise ConfigError(f'{name} has no coefficient or option {key!r}', where='--set', todo=todo)
    if not settings:
        return name
    priors = {'prior_mean': means, 'prior_std': stds}
    return {'name': name} | {field: given for field, given in priors.items() if given} | options


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
