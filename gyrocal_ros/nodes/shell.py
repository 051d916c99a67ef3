"""Starts and ends a node."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.nodes.executor import LeanExecutor


class ClosableNode(Protocol):
    """A node with a `close` to call at its end."""

    @property
    def node(self) -> Node:
        """The node that the executor spins."""

    def close(self) -> None:
        """Save the results; end threads and close files."""


def run(make: Callable[[], ClosableNode], argv: Sequence[str]) -> int:
    """Spin a node until the context is shut down.

    Returns:
        Exit status: 0 after a shutdown, 2 after an error that the user can fix.
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
        if rclpy.ok():  # otherwise the context was shut down in the middle of a call
            raise
    finally:
        rclpy.try_shutdown()
    return 0


def _spin(running: ClosableNode) -> None:
    gc.collect()
    gc.freeze()  # objects of the start stay alive: scanning them in each collection would delay messages
    try:
        rclpy.spin(running.node, LeanExecutor())
    finally:
        running.close()
        running.node.destroy_node()
