"""Publishes the health of a node on `/diagnostics`, and logs its problems."""

from __future__ import annotations

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gyrocal_ros.robot.health import Level, Status
from gyrocal_ros.robot.problem_log import ProblemLog

PERIOD_S = 1.0


class Diagnostics:
    """Publishes the status of a node once a second; new problems, and those that last, are logged, too.

    Args:
        node: the node.
        status: returns its status.
    """

    def __init__(self, node: Node, status: Callable[[], Status]) -> None:
        self._node, self._status, self._log = node, status, ProblemLog()
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # By the steady clock: the status is published also while the clock of the stamps does not advance.
        self._timer = node.create_timer(PERIOD_S, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish(self) -> None:
        """Publish the status now."""
        health = self._status()
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
        self._log_problems(health)
        self._publisher.publish(array)

    def _log_problems(self, health: Status) -> None:
        logger = self._node.get_logger()
        for problem in self._log.due(health, time.monotonic()):
            # Two calls: rclpy keeps one severity for each line of the code.
            if problem.level is Level.ERROR:
                logger.error(problem.text)
            else:
                logger.warning(problem.text)
