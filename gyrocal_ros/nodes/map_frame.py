"""The transform from map to odom, as long as nobody else gives odom a parent."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import Mount, OdometryEstimate
from gyrocal_ros.msgs.outputs import map_to_odom
from gyrocal_ros.msgs.to_ros import MessageMaker, transform
from gyrocal_ros.msgs.topics import ODOM_FRAME, stamp_ns
from gyrocal_ros.nodes.endpoints import mailbox, publish, waiting
from gyrocal_ros.robot.odom_parent import OdomParentGuard

EVERY_NS = 45_000_000
"""So long between two: 20 in a second are enough for whoever looks up where the robot is."""
SOME = QoSProfile(depth=30, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Others send their transforms again and again: a look at the last of them now and then is enough."""


class MapFrame:
    """Sends where odom lies in the map.

    Args:
        node: sends it.
        make: makes messages.
    """

    def __init__(self, node: Node, make: MessageMaker) -> None:
        self._make, self._odom_frame = make, ODOM_FRAME
        self._parents = OdomParentGuard(time.monotonic())
        self._sent_ns = 0
        self._publisher = publish(node, TFMessage, '/tf', QoSProfile(depth=100))
        self._others = mailbox(node, TFMessage, '/tf', SOME)

    @property
    def complaint(self) -> str:
        """What is in the way, empty for nothing."""
        return self._parents.complaint(time.monotonic())

    def send(self, place: OdometryEstimate, in_odom: Mount, frame: str, odom_frame: str) -> None:
        """Send it, by where the body is in both frames at one moment, unless that was done just now."""
        self._odom_frame = odom_frame
        if abs(place.t_ns - self._sent_ns) < EVERY_NS or not self._parents.may_send(time.monotonic()):
            return
        self._sent_ns = place.t_ns
        self._parents.sent(frame, place.t_ns)
        link = map_to_odom(place, in_odom, frame, odom_frame)
        self._publisher.publish(transform(self._make, place.t_ns, link))

    def look(self) -> None:
        """Look whether somebody else gives odom a parent; to be called now and then."""
        for message in waiting(self._others):
            self.hear(message, is_static=False)

    def hear(self, message: TFMessage, *, is_static: bool) -> None:
        """Take in transforms that came, perhaps our own."""
        for link in message.transforms:
            if link.child_frame_id == self._odom_frame:
                now_s = time.monotonic()
                self._parents.heard(link.header.frame_id, stamp_ns(link), now_s, is_static=is_static)
