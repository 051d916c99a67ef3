"""Other recorded numbers that effects of the model follow, found in the graph by their names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from operator import attrgetter
from typing import Any

from rclpy.node import Node
from rosidl_runtime_py.utilities import get_message

from gyrocal_ros.data import CovariateSample
from gyrocal_ros.msgs.topics import stamp_ns
from gyrocal_ros.nodes.endpoints import subscribe
from gyrocal_ros.nodes.qos import SENSOR_IN


class Signals:
    """Subscribes to what is wanted as soon as somebody publishes it.

    Args:
        node: gets the subscriptions.
        names: as in a bag, `battery_state.current`: the topic, then the field.
        now_ns: what the clock of the sensors shows, for messages without a stamp; 0 while nobody knows.
        hear: told of every number.
    """

    def __init__(
        self,
        node: Node,
        names: Iterable[str],
        now_ns: Callable[[], int],
        hear: Callable[[CovariateSample], None],
    ) -> None:
        self._node, self._now_ns, self._hear = node, now_ns, hear
        self._missing = set(names)

    def look(self) -> None:
        """See whether what is missing has come; to be called now and then."""
        if not self._missing:
            return
        types = dict(self._node.get_topic_names_and_types())
        for name in sorted(self._missing):
            for topic, field in _readings(name):
                found = types.get(self._node.resolve_topic_name(topic))
                if found:
                    self._subscribe(name, get_message(found[0]), topic, field)
                    self._missing.discard(name)
                    break

    def _subscribe(self, name: str, kind: type[Any], topic: str, field: str) -> None:
        read, has_header = attrgetter(field), 'header' in kind.get_fields_and_field_types()

        def hear(message: Any) -> None:
            t_ns = stamp_ns(message) if has_header else self._now_ns()
            if t_ns:
                self._hear(CovariateSample(t_ns, name, float(read(message))))

        subscribe(self._node, kind, topic, hear, SENSOR_IN)


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """Every topic and field that a name may mean, the longest topic first."""
    parts = name.split('.')
    for place in range(len(parts) - 1, 0, -1):
        yield '/'.join(parts[:place]), '.'.join(parts[place:])
