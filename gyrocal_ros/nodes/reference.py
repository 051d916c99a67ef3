"""Subscription to the heading reference of a running robot, whose type shows when it is published."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rosidl_runtime_py.utilities import get_message
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import HeadingSample
from gyrocal_ros.msgs.headings import HEADING_TYPES, FrameHeading, heading_conversion, parse_heading_name
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.endpoints import SortedSubscriptions, subscribe, take_messages
from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.qos import SENSOR_IN


class ReferenceSubscription:
    """Subscribes to a heading reference as soon as its topic has a publisher.

    Args:
        node: the node that subscribes.
        sensors: its subscriptions to sensors, with whose messages the headings are sorted.
        text: name of the reference, see `msgs.headings`; empty for none.
        take: called with each heading and the time of its arrival, by the monotonic clock.
        guard: protects the callbacks.

    Raises:
        ConfigError: the text does not name a reference.
    """

    def __init__(
        self,
        node: Node,
        sensors: SortedSubscriptions,
        text: str,
        take: Callable[[HeadingSample, float], None],
        guard: Guard,
    ) -> None:
        self._node, self._sensors, self._take, self._guard = node, sensors, take, guard
        self._name = parse_heading_name(text) if text else None
        self.problem = ''
        """Why there are no headings, for the user; empty where there are."""
        if self._name is not None and self._name.frames:
            self._frames = FrameHeading(*self._name.frames)
            take_frame = guard(Role.HEADING, self._take_frame)
            self._transforms = subscribe(node, TFMessage, '/tf', take_frame, SENSOR_IN)
            self._name = None

    def poll(self) -> None:
        """Look for the topic; call it about once a second."""
        if self._name is None:
            return
        topic = self._node.resolve_topic_name(self._name.topic)
        types = dict(self._node.get_topic_names_and_types()).get(topic, [])
        fitting = [name for name in types if self._name.field or name in HEADING_TYPES]
        if not fitting:
            published = f'publishes {types[0]}, which has no heading' if types else 'is not published yet'
            self.problem = f'heading reference {topic} {published}'
            return
        conversion = heading_conversion(fitting[0], self._name)

        def take(message: Any) -> None:
            self._take(conversion.value(message), time.monotonic())

        self._sensors.subscribe(get_message(fitting[0]), topic, self._guard(Role.HEADING, take))
        self._name, self.problem = None, ''

    def _take_frame(self, message: TFMessage) -> None:
        """Take a message and all that wait behind it: the executor delivers but one of them at a time."""
        for item in (message, *take_messages(self._transforms)):
            if (sample := self._frames.add(item)) is not None:
                self._take(sample, time.monotonic())
