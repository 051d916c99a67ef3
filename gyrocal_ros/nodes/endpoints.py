"""Publishers and subscriptions of low cost, and subscriptions that are polled.

`take_messages` uses the handle of a subscription, which rclpy does not document: it is as in ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from gyrocal_ros.msgs.topics import stamp_ns
from gyrocal_ros.nodes.qos import NO_EVENTS_IN, NO_EVENTS_OUT


def publish(node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> Publisher:
    """Make a publisher without QoS event callbacks."""
    return node.create_publisher(kind, topic, qos, event_callbacks=NO_EVENTS_OUT)


def subscribe(
    node: Node, kind: type[Any], topic: str, callback: Callable[..., None], qos: QoSProfile
) -> Subscription:
    """Make a subscription without QoS event callbacks.

    Args:
        node: the node that subscribes.
        kind: type of the messages.
        topic: name of the topic.
        callback: called with a message and, if it has a second argument, with the message info.
        qos: quality of service.
    """
    return node.create_subscription(kind, topic, callback, qos, event_callbacks=NO_EVENTS_IN)


def take_messages(subscription: Subscription) -> Iterator[Any]:
    """Take the messages out of the queue of a subscription, oldest first."""
    while True:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        yield taken[0]


def polled_subscription(node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> Subscription:
    """Make a subscription for `take_messages` only: the executor does not wake up for its messages."""
    return node.create_subscription(
        kind, topic, lambda message: None, qos, callback_group=_NeverExecuted(), event_callbacks=NO_EVENTS_IN
    )


class SortedSubscriptions:
    """Subscriptions whose queued messages are delivered in the order of their stamps.

    An executor delivers one message of each topic in turn. After a pause, the messages of a slow topic would
    be delivered long before older ones of a fast topic. A second message of a topic shows a pause; only
    then the other topics are looked through.

    Args:
        node: the node that subscribes.
        qos: quality of service of all topics.
    """

    def __init__(self, node: Node, qos: QoSProfile) -> None:
        self._node, self._qos = node, qos
        self._streams: list[tuple[Subscription, Callable[[Any], None]]] = []

    def subscribe(self, kind: type[Any], topic: str, callback: Callable[[Any], None]) -> None:
        """Add a topic of messages with headers; at equal stamps, the topic added first comes first."""
        subscription = self._node.create_subscription(
            kind,
            topic,
            partial(self._deliver, len(self._streams)),
            self._qos,
            event_callbacks=NO_EVENTS_IN,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._streams.append((subscription, callback))

    def _deliver(self, stream: int, message: Any) -> None:
        subscription, callback = self._streams[stream]
        later = list(take_messages(subscription))
        if not later:
            callback(message)
            return
        queued = [(stream, item) for item in (message, *later)]
        for number, (other, _) in enumerate(self._streams):
            queued += [(number, item) for item in take_messages(other)]
        for number, item in sorted(queued, key=lambda item: (stamp_ns(item[1]), item[0])):
            self._streams[number][1](item)


class _NeverExecuted(CallbackGroup):
    """Callback group that no executor calls."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return
