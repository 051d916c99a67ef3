"""Health on `/diagnostics`."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gyrocal_ros.robot.health import Status

PERIOD_S = 1.0


class Diagnostics:
    """Tells once a second how a node is.

    Args:
        node: whose health it is.
        tell: returns it.
    """

    def __init__(self, node: Node, tell: Callable[[], Status]) -> None:
        self._node, self._tell = node, tell
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # By the steady clock: the clock of the stamps may stand still, and that is worth telling.
        self._timer = node.create_timer(PERIOD_S, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Tell it now."""
        health = self._tell()
        values = [KeyValue(key=key, value=str(value)) for key, value in health.numbers.items()]
        status = DiagnosticStatus(
            level=bytes([health.level]),
            name=self._node.get_fully_qualified_name().lstrip('/'),
            message=health.message,
            hardware_id='',
            values=values,
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
