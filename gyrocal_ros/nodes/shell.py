"""Start and end of a node."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from gyrocal_ros.errors import GyrocalError


class Running(Protocol):
    """A node with something to put in order at its end."""

    @property
    def node(self) -> Node:
        """What the executor turns."""

    def close(self) -> None:
        """Save what has to be kept and let go of threads and files."""


def run(make: Callable[[], Running], argv: Sequence[str]) -> int:
    """Spin a node until the context is shut down.

    Returns:
        Exit status: 0 told to stop, 2 the user can mend it.
    """
    rclpy.init(args=[sys.argv[0], *argv])
    try:
        _spin(make())
    except GyrocalError as error:
        print(f'error: {error}', file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():  # else the end has come in the middle of something
            raise
    finally:
        rclpy.try_shutdown()
    return 0


def _spin(running: Running) -> None:
    gc.collect()
    gc.freeze()  # what is there now stays: looking through it again and again makes messages wait
    try:
        rclpy.spin(running.node)
    finally:
        running.close()
        running.node.destroy_node()
