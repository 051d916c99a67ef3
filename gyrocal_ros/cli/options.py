"""Options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from gyrocal_ros.bag.selection import parse_remap
from gyrocal_ros.config.parameter_file import load_config
from gyrocal_ros.config.sections import Config


class BagOptions(TypedDict):
    """Topics of a bag, as the user gave them: keywords of `open_bag` and `check_bag`."""

    remap: dict[str, str]
    namespace: str | None
    heading_reference: str | None


def add_bag_options(parser: argparse.ArgumentParser) -> None:
    """Declare the bag and the options for reading it."""
    parser.add_argument('bag', type=Path, help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag')
    add_topic_options(parser)


def add_topic_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options for reading a bag."""
    parser.add_argument(
        '-r',
        '--remap',
        action='append',
        default=[],
        metavar='NAME:=TOPIC',
        help='use TOPIC in place of NAME, as in -r imu/data_raw:=/imu/data; may be repeated',
    )
    parser.add_argument('--namespace', metavar='NAME', help='robot to use, if the bag contains several')
    parser.add_argument(
        '--heading-reference',
        metavar='TOPIC',
        help='take the heading from this topic in place of the ceiling camera: odometry, a pose, a '
        'transform, an orientation, a magnetic field; TOPIC.FIELD for a yaw, tf:PARENT:CHILD for a frame',
    )
    add_config_option(parser)


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """Declare the settings file."""
    parser.add_argument('--config', type=Path, metavar='FILE', help='settings, a ROS 2 parameter file')


def add_images_option(parser: argparse.ArgumentParser) -> None:
    """Declare the option to track images even if the bag contains the output of a tracker."""
    parser.add_argument(
        '--from-images',
        action='store_true',
        help='track features in the images even if the bag contains features',
    )


def complete_with(action: argparse.Action, names: Iterable[str]) -> None:
    """Let the shell complete the value of an argument.

    Args:
        action: the argument, as `add_argument` returns it.
        names: the possible values.
    """
    vars(action)['completer'] = lambda **_: names


def read_config(args: argparse.Namespace) -> Config:
    """Read the settings file, if one is given; `--from-images`, if declared, overrides it.

    Raises:
        ConfigError: it cannot be read, or a setting in it is unknown or out of bounds.
    """
    config = load_config(args.config)
    if vars(args).get('from_images'):
        return replace(config, recording=replace(config.recording, use_images=True))
    return config


def bag_options(args: argparse.Namespace) -> BagOptions:
    """Return the keywords of `open_bag` and `check_bag`.

    Raises:
        ConfigError: a remap is not written NAME:=TOPIC.
    """
    return {
        'remap': parse_remap(args.remap),
        'namespace': args.namespace,
        'heading_reference': args.heading_reference,
    }
