"""Options that several commands share."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from gyrocal_ros.bag.selection import parse_remap
from gyrocal_ros.config.parameter_file import load_config
from gyrocal_ros.config.sections import Config


class BagOptions(TypedDict):
    """What a person says about the topics of a bag: the keywords of `open_bag` and `check_bag`."""

    remap: dict[str, str]
    namespace: str | None
    heading_reference: str | None


def add_bag_options(parser: argparse.ArgumentParser) -> None:
    """Declare the bag to read and all that says how to read it."""
    parser.add_argument('bag', type=Path, help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag')
    add_topic_options(parser)


def add_topic_options(parser: argparse.ArgumentParser) -> None:
    """Declare all that says how to read a bag."""
    parser.add_argument(
        '-r',
        '--remap',
        action='append',
        default=[],
        metavar='NAME:=TOPIC',
        help='a topic under another name, as in -r imu/data_raw:=/imu/data; may be repeated',
    )
    parser.add_argument('--namespace', metavar='NAME', help='which robot, where the bag holds several')
    parser.add_argument(
        '--heading-reference',
        metavar='TOPIC',
        help='take the heading from this Odometry or PoseStamped topic in place of the ceiling camera',
    )
    add_config_option(parser)


def add_config_option(parser: argparse.ArgumentParser) -> None:
    """Declare the settings file."""
    parser.add_argument('--config', type=Path, metavar='FILE', help='settings, a ROS 2 parameter file')


def add_images_option(parser: argparse.ArgumentParser) -> None:
    """Declare that images are wanted even where a tracker was recorded."""
    parser.add_argument(
        '--from-images', action='store_true', help='track the images even if there are features'
    )


def read_config(args: argparse.Namespace) -> Config:
    """Read the settings file, if one is given; `--from-images`, where it is declared, goes before it.

    Raises:
        ConfigError: it cannot be read, or a setting in it is unknown or out of bounds.
    """
    config = load_config(args.config)
    if vars(args).get('from_images'):
        return replace(config, recording=replace(config.recording, use_images=True))
    return config


def bag_options(args: argparse.Namespace) -> BagOptions:
    """Return the keywords for `open_bag` and `check_bag`.

    Raises:
        ConfigError: a remap is not written NAME:=TOPIC.
    """
    return {
        'remap': parse_remap(args.remap),
        'namespace': args.namespace,
        'heading_reference': args.heading_reference,
    }
