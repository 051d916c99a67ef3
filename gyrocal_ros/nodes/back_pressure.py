"""Back-pressure of the player: the calibrator answers every IMU sample, and the tracker every image."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2

from gyrocal_ros.bag.pacing import MAX_UNANSWERED, Pacing
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.endpoints import subscribe
from gyrocal_ros.nodes.qos import SENSOR_OUT

MAX_IMAGES = 2
"""Number of images sent ahead of the tracker, whose queue is as short."""
ANSWERS: dict[Role, tuple[type[Any], str, int]] = {
    Role.IMU: (Imu, 'imu/data', MAX_UNANSWERED),
    Role.IMAGE: (PointCloud2, Role.FEATURES, MAX_IMAGES),
}
"""Type and topic of the answers to a played topic, and the number of messages sent ahead of them."""
MAX_LOST = 1e-3
"""Share of lost messages from which the playback has failed."""


class BackPressure:
    """Holds messages back whose listener is behind, and counts those that it never answered.

    Args:
        node: the player.
        played: names of the topics that it plays.
    """

    def __init__(self, node: Node, played: Iterable[str]) -> None:
        self._pacing: dict[str, Pacing] = {}
        for name in played:
            role = next((role for role in ANSWERS if name.startswith(role)), None)
            if role is not None:
                kind, answer, limit = ANSWERS[role]
                pacing = self._pacing[name] = Pacing(limit)
                subscribe(node, kind, answer, lambda _, p=pacing: p.add_answer(time.monotonic()), SENSOR_OUT)

    def may_send(self, name: str) -> bool:
        """Return True if the next message of a topic need not wait."""
        return name not in self._pacing or self._pacing[name].may_send(time.monotonic())

    def add_sent(self, name: str) -> None:
        """Count a message of a topic."""
        if name in self._pacing:
            self._pacing[name].add_sent()

    @property
    def is_waiting(self) -> bool:
        """True while answers may still come."""
        return any(pacing.is_waiting(time.monotonic()) for pacing in self._pacing.values())

    def losses(self) -> str:
        """Return the numbers of lost messages in a clause; empty if there are hardly any."""
        for pacing in self._pacing.values():
            pacing.finish()
        return ', '.join(
            f'{pacing.lost} of {pacing.sent} messages of {name}'
            for name, pacing in self._pacing.items()
            if pacing.lost > MAX_LOST * pacing.sent
        )
