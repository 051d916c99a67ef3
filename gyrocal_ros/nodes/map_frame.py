"""Publishes the transform from map to odom, unless odom has another parent."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import Mount, OdometryEstimate
from gyrocal_ros.msgs.outputs import map_to_odom
from gyrocal_ros.msgs.to_ros import MessageMaker, transform
from gyrocal_ros.msgs.topics import ODOM_FRAME, stamp_ns
from gyrocal_ros.nodes.endpoints import polled_subscription, publish, take_messages
from gyrocal_ros.robot.odom_parent import OdomParentGuard

PERIOD_NS = 45_000_000
"""Shortest time between two transforms, about 20 a second: enough for lookups of the pose."""
OTHERS_QOS = QoSProfile(depth=30, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS for the transforms of others. They are repeated, so that the last few of each check are enough."""


class MapFrame:
    """Publisher of the transform from map to odom.

    Args:
        node: the node that publishes.
        make: makes messages.
    """

    def __init__(self, node: Node, make: MessageMaker) -> None:
        self._make, self._odom_frame = make, ODOM_FRAME
        self._guard = OdomParentGuard(time.monotonic())
        self._sent_ns = 0
        self._publisher = publish(node, TFMessage, '/tf', QoSProfile(depth=100))
        self._others = polled_subscription(node, TFMessage, '/tf', OTHERS_QOS)

    @property
    def problem(self) -> str:
        """Why the transform is not published; empty without a reason."""
        return self._guard.problem(time.monotonic())

    def send(self, estimate: OdometryEstimate, in_odom: Mount, frame: str, odom_frame: str) -> None:
        """Publish the transform, at most every `PERIOD_NS`.

        Args:
            estimate: pose of the body in the map frame.
            in_odom: pose of the body in the odom frame at the same time.
            frame: name of the map frame.
            odom_frame: name of the odom frame.
        """
        self._odom_frame = odom_frame
        if abs(estimate.t_ns - self._sent_ns) < PERIOD_NS or not self._guard.may_send(time.monotonic()):
            return
        self._sent_ns = estimate.t_ns
        self._guard.add_own(frame, estimate.t_ns)
        link = map_to_odom(estimate, in_odom, frame, odom_frame)
        self._publisher.publish(transform(self._make, estimate.t_ns, link))

    def poll(self) -> None:
        """Check the transforms of other nodes for another parent of odom; call it about once a second."""
        for message in take_messages(self._others):
            self.add_received(message, is_static=False)

    def add_received(self, message: TFMessage, *, is_static: bool) -> None:
        """Take in received transforms, which may be own ones."""
        for link in message.transforms:
            if link.child_frame_id == self._odom_frame:
                now_s = time.monotonic()
                self._guard.add_received(link.header.frame_id, stamp_ns(link), now_s, is_static=is_static)
