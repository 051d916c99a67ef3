"""Options of the commands that need a sensor model or the effect library."""

from __future__ import annotations

import argparse
from pathlib import Path

from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.effects.registry import load_file, load_installed
from gyrocal_ros.model.sensor import SensorModel


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Declare the sensor model and the file of the user's effects."""
    parser.add_argument('--model', type=Path, metavar='FILE', help='sensor model (model.yaml)')
    add_own_effects_option(parser)


def add_own_effects_option(parser: argparse.ArgumentParser) -> None:
    """Declare the file of the user's effects."""
    parser.add_argument(
        '--effects-from',
        type=Path,
        metavar='FILE',
        help='Python file with effects of your own, see docs/your_own_effect.md',
    )


def read_model(args: argparse.Namespace) -> SensorModel:
    """Load the user's effects, then the sensor model.

    Raises:
        ConfigError: one of them cannot be used.
    """
    load_own_effects(args)
    return load_model(args.model)


def load_own_effects(args: argparse.Namespace) -> None:
    """Load the user's effects into the library, from installed packages and from the file given.

    Raises:
        ConfigError: one of them cannot be used.
    """
    load_installed()
    if args.effects_from:
        load_file(args.effects_from)
