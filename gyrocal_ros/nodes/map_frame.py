"""The transform from map to odom, as long as nobody else gives odom a parent."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from tf2_msgs.msg import TFMessage

from gyrocal_ros.data import Mount, Whereabouts
from gyrocal_ros.live.parents import OdomParents
from gyrocal_ros.recording.messages import MessageMaker, transform
from gyrocal_ros.recording.outputs import map_to_odom
from gyrocal_ros.recording.topics import stamp_ns

LOOK_EVERY = 5
"""Others send their transforms again and again: a look at some of them is enough, and costs less."""
LISTEN = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


class MapFrame:
    """Sends where odom lies in the map.

    Args:
        node: sends it.
        make: makes messages.
    """

    def __init__(self, node: Node, make: MessageMaker) -> None:
        self._make, self._odom_frame = make, 'odom'
        self._parents = OdomParents(time.monotonic())
        self._heard = 0
        self._publisher = node.create_publisher(TFMessage, '/tf', 100)
        node.create_subscription(TFMessage, '/tf', self._hear_some, LISTEN, raw=True)

    @property
    def complaint(self) -> str:
        """What is in the way, empty for nothing."""
        return self._parents.complaint(time.monotonic())

    def send(self, place: Whereabouts, in_odom: Mount, frame: str, odom_frame: str) -> None:
        """Send it, by where the body is in both frames at one moment."""
        self._odom_frame = odom_frame
        if self._parents.may_send(time.monotonic()):
            self._parents.sent(frame, place.t_ns)
            link = map_to_odom(place, in_odom, frame, odom_frame)
            self._publisher.publish(transform(self._make, place.t_ns, link))

    def hear(self, message: TFMessage, *, is_static: bool) -> None:
        """Look whether somebody else gives odom a parent."""
        for link in message.transforms:
            if link.child_frame_id == self._odom_frame:
                now_s = time.monotonic()
                self._parents.heard(link.header.frame_id, stamp_ns(link), now_s, is_static=is_static)

    def _hear_some(self, raw: bytes) -> None:
        self._heard += 1
        if self._heard % LOOK_EVERY == 0:
            self.hear(deserialize_message(raw, TFMessage), is_static=False)
