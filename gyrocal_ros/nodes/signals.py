"""Subscribes to the signals that effects of the model depend on, found in the graph by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from typing import Any

from rclpy.node import Node
from rosidl_runtime_py.utilities import get_message

from gyrocal_ros.data import CovariateSample
from gyrocal_ros.msgs.topics import stamp_ns
from gyrocal_ros.nodes.endpoints import subscribe
from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.qos import SENSOR_IN


class Signals:
    """Subscribes to each signal once it is published.

    Args:
        node: the node that subscribes.
        names: names of the signals as in a bag, `battery_state.current`: topic, then field.
        now_ns: returns the present time of the sensors' clock, for messages without a stamp; 0 if unknown.
        callback: called with each value.
        guard: protects the callbacks.
    """

    def __init__(
        self,
        node: Node,
        names: Iterable[str],
        now_ns: Callable[[], int],
        callback: Callable[[CovariateSample], None],
        guard: Guard,
    ) -> None:
        self._node, self._now_ns, self._callback = node, now_ns, callback
        self._guard = guard
        self._missing = set(names)

    def poll(self) -> None:
        """Subscribe to missing signals that are published by now; call it about once a second."""
        if not self._missing:
            return
        types = dict(self._node.get_topic_names_and_types())
        for name in sorted(self._missing):
            for topic, field in _candidates(name):
                found = types.get(self._node.resolve_topic_name(topic))
                if found:
                    self._subscribe(name, get_message(found[0]), topic, field)
                    self._missing.discard(name)
                    break

    def _subscribe(self, name: str, kind: type[Any], topic: str, field: str) -> None:
        read, has_header = attrgetter(field), 'header' in kind.get_fields_and_field_types()

        def receive(message: Any) -> None:
            t_ns = stamp_ns(message) if has_header else self._now_ns()
            if t_ns:
                self._callback(CovariateSample(t_ns, name, float(read(message))))

        subscribe(self._node, kind, topic, self._guard(topic, receive), SENSOR_IN)


def _candidates(name: str) -> Iterator[tuple[str, str]]:
    """Yield every topic and field that a name may mean, the longest topic first."""
    parts = name.split('.')
    for place in range(len(parts) - 1, 0, -1):
        yield '/'.join(parts[:place]), '.'.join(parts[place:])
