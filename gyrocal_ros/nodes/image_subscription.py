"""The subscription of the images: it follows their publishers, which may come, go and change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CompressedImage, Image

from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.endpoints import subscribe

COMPRESSED = 'compressed'
TRANSPORTS = {'raw': ('', Image), COMPRESSED: (f'/{COMPRESSED}', CompressedImage)}
"""Suffix of the topic and message type of each image transport."""
IMAGE_QUEUE = 2
"""Queue depth of the images; the oldest are dropped if they come faster than they can be tracked."""
SEARCH_S = 0.5
"""Period of looking for publishers of images."""


class ImageSubscription:
    """Subscribes to the published images, with the transport and the reliability of their publishers.

    A camera driver that is restarted with other settings is subscribed to again.

    Args:
        node: the node.
        transport: returns the setting `images.transport`.
        callback: called with an image and its message info.
    """

    def __init__(
        self, node: Node, transport: Callable[[], str], callback: Callable[[Any, Any], None]
    ) -> None:
        self._node, self._transport, self._callback = node, transport, callback
        self._present: tuple[str, ReliabilityPolicy] | None = None
        self._subscription: Subscription | None = None
        node.create_timer(SEARCH_S, self._search, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _search(self) -> None:
        found = self._published()
        if found is None or found == self._present:
            return
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        topic, reliability = self._present = found
        kind = CompressedImage if topic.endswith(f'/{COMPRESSED}') else Image
        qos = QoSProfile(depth=IMAGE_QUEUE, reliability=reliability)
        self._subscription = subscribe(self._node, kind, topic, self._callback, qos)
        self._node.get_logger().info(f'tracking images of {topic} ({reliability.name.lower()})')

    def _published(self) -> tuple[str, ReliabilityPolicy] | None:
        """Return topic and reliability of the images that are published; None without any."""
        wanted, name = self._transport(), self._node.resolve_topic_name(Role.IMAGE)
        for transport, (ending, _) in TRANSPORTS.items():
            offered = self._node.get_publishers_info_by_topic(name + ending)
            if offered and wanted in ('auto', transport):
                reliable = all(o.qos_profile.reliability is ReliabilityPolicy.RELIABLE for o in offered)
                return name + ending, (
                    ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
                )
        return None
