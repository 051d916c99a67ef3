"""Entry points of the nodes; without ROS they print what is missing."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

NODES = ('driver', 'tracker', 'calibrator', 'player', 'ceiling_emulator')
"""Names of the nodes; each is a module of this package whose `make` makes the node."""


def run(name: str, argv: Sequence[str]) -> int:
    """Run a node until it is shut down; return its exit status.

    Args:
        name: one of `NODES`.
        argv: command line, with ROS arguments.
    """
    os.environ.setdefault(
        'OPENBLAS_NUM_THREADS', '1'
    )  # threads only slow down matrices as small as those of the filter
    try:
        shell = importlib.import_module('gyrocal_ros.nodes.shell')
        return int(shell.run(importlib.import_module(f'gyrocal_ros.nodes.{name}').make, argv))
    except KeyboardInterrupt:  # before the node was made
        return 130
    except ModuleNotFoundError as error:
        if (error.name or '').startswith('gyrocal_ros'):
            raise
        print(
            f'{name}: error: {error.name} is missing; source the setup.bash of ROS 2 Jazzy first '
            '(bags replay without ROS: `gyrocal replay BAG`)',
            file=sys.stderr,
        )
        return 2


def driver() -> int:
    """`ros2 run gyrocal_ros driver`."""
    return run('driver', sys.argv[1:])


def tracker() -> int:
    """`ros2 run gyrocal_ros tracker`."""
    return run('tracker', sys.argv[1:])


def calibrator() -> int:
    """`ros2 run gyrocal_ros calibrator`."""
    return run('calibrator', sys.argv[1:])


def player() -> int:
    """`ros2 run gyrocal_ros player`."""
    return run('player', sys.argv[1:])


def ceiling_emulator() -> int:
    """`ros2 run gyrocal_ros ceiling_emulator`."""
    return run('ceiling_emulator', sys.argv[1:])
