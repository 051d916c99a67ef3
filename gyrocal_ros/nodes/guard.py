"""Keeps a node alive: an error in a callback is counted and reported, and the next message is processed."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from rclpy.node import Node

from gyrocal_ros.errors import GyrocalError

T = TypeVar('T', bound=Any)

LOG_PERIOD_S = 10.0
"""Shortest time between two logged errors."""


class Guard:
    """Wraps callbacks so that no message can end the node.

    Args:
        node: the node whose log reports defects.
        count: called with the topic and the reason for every message that could not be used.
    """

    def __init__(self, node: Node, count: Callable[[str, str], None]) -> None:
        self._node, self._count = node, count

    def __call__(self, topic: str, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a callback that raises no error while the node runs.

        Args:
            topic: name under which errors are counted.
            callback: callback of a subscription or timer.
        """

        @wraps(callback)  # rclpy reads the signature to decide whether it passes the message info
        def guarded(*args: Any) -> None:
            try:
                callback(*args)
            except GyrocalError as error:
                self._count(topic, str(error))
            except Exception as error:
                if not self._node.context.ok():  # the node was shut down within the callback
                    raise
                self._count(topic, f'internal error: {error!r}')
                text = f'{topic}: internal error, the message is left out\n{traceback.format_exc()}'
                self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD_S)

        return guarded

    def service(self, name: str, callback: Callable[[Any, T], T]) -> Callable[[Any, T], T]:
        """Return a callback of a service that raises no error: the response reports it.

        Args:
            name: name under which errors are counted.
            callback: callback of a service whose response has `success` and `message`.
        """

        @wraps(callback)
        def guarded(request: Any, response: T) -> T:
            problems: list[str] = []

            def answer() -> None:
                callback(request, response)

            def count(topic: str, why: str) -> None:
                self._count(topic, why)
                problems.append(why)

            Guard(self._node, count)(name, answer)()
            if problems:
                response.success, response.message = False, problems[0]
            return response

        return guarded
