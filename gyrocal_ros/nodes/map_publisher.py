"""The map of the ceiling on `ceiling_map`, while somebody subscribes."""

from __future__ import annotations

from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from gyrocal_ros.ekf.state.map import CeilingMap
from gyrocal_ros.msgs import outputs
from gyrocal_ros.msgs.to_ros import MessageMaker
from gyrocal_ros.nodes.qos import LATCHED


class MapPublisher:
    """Publishes the mapped features as markers, and removes the markers of dropped features."""

    def __init__(self, node: Node, make: MessageMaker) -> None:
        self._publisher = node.create_publisher(MarkerArray, 'ceiling_map', LATCHED)
        self._make = make
        self._published: set[int] = set()

    @property
    def is_wanted(self) -> bool:
        """True if there is a subscriber."""
        return self._publisher.get_subscription_count() > 0

    def publish(self, points: CeilingMap, frame: str) -> None:
        """Publish the map in a frame."""
        ids = set(points.ids.tolist())
        features = (points.ids, points.points_m, points.covariances_m2)
        removed = sorted(self._published - ids)
        self._publisher.publish(outputs.ceiling_map(self._make, points.t_ns, frame, *features, removed))
        self._published = ids
