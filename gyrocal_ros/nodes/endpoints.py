"""Publishers and subscriptions that cost little, and messages that are fetched, not delivered."""

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
from gyrocal_ros.nodes.qos import QUIET_IN, QUIET_OUT


def publish(node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> Publisher:
    """Make a publisher that does not watch the quality of service."""
    return node.create_publisher(kind, topic, qos, event_callbacks=QUIET_OUT)


def subscribe(
    node: Node, kind: type[Any], topic: str, hear: Callable[..., None], qos: QoSProfile
) -> Subscription:
    """Make a subscription that does not watch the quality of service.

    Args:
        node: whose it is.
        kind: of the messages.
        topic: their topic.
        hear: takes a message, and what is known of its way if it wants to.
        qos: quality of service.
    """
    return node.create_subscription(kind, topic, hear, qos, event_callbacks=QUIET_IN)


def waiting(subscription: Subscription) -> Iterator[Any]:
    """Yield the messages that have come and that nobody has heard yet, oldest first."""
    while True:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        yield taken[0]


def mailbox(node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> Subscription:
    """Make a subscription whose messages are only fetched (`waiting`): the node does not wake up for each."""
    return node.create_subscription(
        kind, topic, lambda message: None, qos, callback_group=_Unattended(), event_callbacks=QUIET_IN
    )


class Sorted:
    """Subscriptions whose messages are heard in the order of their stamps, as far as they have come.

    An executor delivers one message of each topic in turn. After a pause, those of a slow topic would be
    heard long before older ones of a fast topic.

    Args:
        node: whose they are.
        qos: of all of them.
    """

    def __init__(self, node: Node, qos: QoSProfile) -> None:
        self._node, self._qos = node, qos
        self._streams: list[tuple[Subscription, Callable[[Any], None]]] = []

    def subscribe(self, kind: type[Any], topic: str, hear: Callable[[Any], None]) -> None:
        """Add a topic of messages with headers; of equal stamps, that of the topic added first goes first."""
        subscription = self._node.create_subscription(
            kind,
            topic,
            partial(self._hear, len(self._streams)),
            self._qos,
            event_callbacks=QUIET_IN,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._streams.append((subscription, hear))

    def _hear(self, stream: int, message: Any) -> None:
        come = [(stream, message)]
        for number, (subscription, _) in enumerate(self._streams):
            come += [(number, other) for other in waiting(subscription)]
        if len(come) > 1:
            come.sort(key=lambda item: (stamp_ns(item[1]), item[0]))
        for number, item in come:
            self._streams[number][1](item)


class _Unattended(CallbackGroup):
    """Callbacks that no executor calls."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return
