"""Publishers and subscriptions that cost little: rclpy would look after four more things for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription


def publish(node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> Publisher:
    """Make a publisher that does not watch the quality of service."""
    events = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(kind, topic, qos, event_callbacks=events)


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
    events = SubscriptionEventCallbacks(use_default_callbacks=False)
    return node.create_subscription(kind, topic, hear, qos, event_callbacks=events)


class Mailbox:
    """A subscription whose messages wait until they are fetched: the node does not wake up for each.

    Args:
        node: whose it is.
        kind: of the messages.
        topic: their topic.
        qos: as deep as messages come between two fetches.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: QoSProfile) -> None:
        self._subscription = node.create_subscription(
            kind,
            topic,
            lambda message: None,
            qos,
            callback_group=_Unattended(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def fetch(self) -> Iterator[Any]:
        """Yield the messages that have come, oldest first."""
        subscription = self._subscription
        with subscription.handle:
            while (
                taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)
            ) is not None:
                yield taken[0]


class _Unattended(CallbackGroup):
    """Callbacks that no executor calls."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return
