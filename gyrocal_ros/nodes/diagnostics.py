"""Publishes the health of a node on `/diagnostics`, and logs its problems."""

from __future__ import annotations

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.qos_watch import incompatible_endpoints
from gyrocal_ros.robot.health import Level, Problem, Status, as_warnings, status
from gyrocal_ros.robot.problem_log import ProblemLog

PERIOD_S = 1.0
QOS_PERIOD_S = 5.0
"""Period at which the QoS of the endpoints of other nodes is compared."""


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
        publish = Guard(node, self._report_failure)('/diagnostics', self.publish)
        self._timer = node.create_timer(PERIOD_S, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._incompatible: list[str] = []
        self._checked_s = time.monotonic()

    def publish(self) -> None:
        """Publish the status now."""
        health, now_s = self._status(), time.monotonic()
        if now_s - self._checked_s >= QOS_PERIOD_S:
            self._incompatible, self._checked_s = list(incompatible_endpoints(self._node)), now_s
        if self._incompatible:
            problems = [*health.problems, *as_warnings(self._incompatible)]
            health = status(health.message, problems, health.numbers)
        self._send(health)

    def _report_failure(self, _: str, why: str) -> None:
        """Publish that the status could not be determined."""
        self._send(status('', [Problem(Level.ERROR, f'the status is unknown: {why}')], {}))

    def _send(self, health: Status) -> None:
        values = [KeyValue(key=key, value=str(value)) for key, value in health.numbers.items()]
        described = DiagnosticStatus(
            level=bytes([health.level]),
            name=self._node.get_fully_qualified_name().lstrip('/'),
            message=health.message,
            hardware_id='',
            values=values,
        )
        array = DiagnosticArray(status=[described])
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
