"""Put a physical effect into a sensor model, model.yaml.

From then on it is estimated with everything else, in replay and on the robot. A model that does not
exist yet begins as the default one. One that does is added to, its comments and all else stay.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gyrocal_ros.cli.model_options import add_own_effects_option, load_own_effects
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.model_file import load_model, with_entry
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.files import shipped, write_text_atomic

EXAMPLE = """gyrocal add gyro_lag --model model.yaml
gyrocal add covariate_bias:battery_state.current --model model.yaml -o heavier.yaml
gyrocal add rate_saturation --set limit=1.05 --model model.yaml"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument('effect', metavar='EFFECT', help='its name, see `gyrocal effects`')
    parser.add_argument(
        '--model', type=Path, metavar='FILE', default=Path('model.yaml'), help='what to add to (%(default)s)'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='what a coefficient is expected to be, in its unit, or an option of the effect; may be repeated',
    )
    add_own_effects_option(parser)
    parser.add_argument('-o', '--out', type=Path, metavar='FILE', help='where to (into the model itself)')
    parser.add_argument('--overwrite', action='store_true', help='write over a file OUT of an earlier time')


def run(args: argparse.Namespace) -> None:
    """Add the effect, and say what the model then is.

    Raises:
        ConfigError: there is no such effect, or the model cannot be used.
    """
    load_own_effects(args)
    entry = entry_of(args.effect, args.set)
    start = args.model if args.model.exists() else shipped('config/model.yaml')
    names = [effect.name for effect in load_model(start).effects]
    text, out = start.read_text(encoding='utf-8'), args.out or args.model
    if args.effect in names:
        print(f'{start}: has {args.effect} already, and keeps it as it is')
    else:
        text = with_entry(text, entry, str(start))
        names.append(args.effect)
    write_text_atomic(out, text, overwrite=args.overwrite or args.out is None)
    print(f'{out}: {", ".join(names)}')


def entry_of(name: str, settings: Sequence[str]) -> str | Mapping[str, Any]:
    """An effect as it stands in `model.yaml`, with what was set.

    Args:
        name: of the effect.
        settings: NAME=VALUE, the name that of a coefficient or of an option of the effect.

    Raises:
        ConfigError: there is no such effect, or a setting is not written so.
    """
    coefficients = [item.name for item in find_effect(name).coefficients]
    means: dict[str, float | str] = {}
    options: dict[str, float | str] = {}
    for setting in settings:
        key, equals, value = setting.partition('=')
        if not equals:
            raise ConfigError(f'is {setting!r}', where='--set', todo='write it as NAME=VALUE')
        (means if key in coefficients else options)[key] = _number_or_text(value)
    if not settings:
        return name
    return {'name': name} | ({'prior_mean': means} if means else {}) | options


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
