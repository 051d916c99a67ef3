"""The driver as a process, at the port of an emulated board, in a real graph."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from emulated import BoardProgram
from graph import Graph
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Imu, Temperature
from tf2_msgs.msg import TFMessage

from gyrocal_ros.msgs import topics
from gyrocal_ros.nodes.qos import SENSOR_IN
from gyrocal_ros.robot.health import Level


@dataclass
class Robot:
    """A graph, a port for a board, and the received outputs of the driver."""

    graph: Graph
    port: Path
    imu: list[Any] = field(default_factory=list)
    health: list[Any] = field(default_factory=list)

    def start(self, **parameters: Any) -> None:
        """Start the driver with parameters of the section `driver`."""
        self.imu = self.graph.listen(Imu, 'imu/data_raw', SENSOR_IN)
        self.health = self.graph.listen(DiagnosticArray, '/diagnostics')
        given = {f'driver.{name}': value for name, value in parameters.items()}
        self.graph.start('driver', parameters={'driver.port': str(self.port), **given})

    def wait_for_imu(self, count: int = 20) -> None:
        more = len(self.imu) + count
        self.graph.wait(lambda: len(self.imu) >= more, 'imu/data_raw')

    def wait_for_health(self, words: str, level: Level) -> None:
        self.health.clear()

        def is_reported() -> bool:
            own = [status for message in self.health for status in message.status if status.name == 'driver']
            return any(words in status.message and status.level == bytes([level]) for status in own)

        self.graph.wait(is_reported, f'{words!r} in /diagnostics')


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with Graph() as graph:
        yield Robot(graph, tmp_path / 'board')


def test_all_measurements_of_the_board_are_published(robot: Robot) -> None:
    graph = robot.graph
    robot.start(publish_odom_transform=True)
    wheels = graph.listen(Odometry, 'wheel/odometry', SENSOR_IN)
    temperatures = graph.listen(Temperature, 'imu/temperature', SENSOR_IN)
    battery = graph.listen(BatteryState, 'battery_state', SENSOR_IN)
    transforms = graph.listen(TFMessage, '/tf')
    start_s = time.time() - 10.0  # it drives by now
    with BoardProgram(robot.port, '--seed', '3', '--start-at', str(start_s)):
        robot.wait_for_imu(100)
        graph.wait(lambda: len(wheels) > 20 and temperatures and battery and transforms, 'all topics')
    first = robot.imu[0]
    assert first.header.frame_id == 'imu_link'
    assert first.orientation_covariance[0] == -1.0
    assert first.linear_acceleration.z == pytest.approx(9.8, abs=1.5)
    odometry = wheels[-1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ('odom', 'base_link')
    assert odometry.twist.twist.linear.x != 0.0 or odometry.twist.twist.angular.z != 0.0
    assert odometry.pose.pose.position.x != 0.0 or odometry.pose.pose.orientation.z != 0.0
    assert 0.0 < temperatures[0].temperature < 60.0
    assert battery[0].voltage == pytest.approx(16.0, abs=1.0)
    assert battery[0].current < 0.0 and math.isnan(battery[0].percentage)
    [link] = transforms[-1].transforms
    assert (link.header.frame_id, link.child_frame_id) == ('odom', 'base_link')
    for message in (first, odometry, temperatures[0], battery[0], link):
        assert topics.stamp_ns(message) / 1e9 > start_s + 9.0


def test_an_unplugged_board_is_reported_and_reconnected(robot: Robot) -> None:
    robot.start()
    robot.wait_for_health('is not there; plug the board in', Level.ERROR)
    with BoardProgram(robot.port, '--scenario', 'standing') as board:
        robot.wait_for_imu()
        robot.wait_for_health('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
        board.inject_fault('unplug+2')
        robot.wait_for_health('not connected for', Level.ERROR)
        robot.wait_for_imu()
        robot.wait_for_health('frames were lost recently', Level.WARN)
        board.inject_fault('noise+2=0.01')
        robot.wait_for_health('of the frames are corrupted', Level.WARN)
        robot.wait_for_health('IMU 200 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
    stamps = [topics.stamp_ns(message) for message in robot.imu]
    assert all(a < b for a, b in pairwise(stamps))


def test_rates_change_at_run_time_and_impossible_ones_are_reported(robot: Robot) -> None:
    robot.start()
    with BoardProgram(robot.port, '--scenario', 'standing'):
        robot.wait_for_imu()
        assert robot.graph.set_parameter('driver', 'driver.imu_hz', 100).successful
        robot.wait_for_health('IMU 100 Hz, wheels 50 Hz, supply 10 Hz', Level.OK)
        steps_ms = {
            round((topics.stamp_ns(b) - topics.stamp_ns(a)) / 1e6) for a, b in pairwise(robot.imu[-50:])
        }
        assert steps_ms == {10}
        assert robot.graph.set_parameter('driver', 'driver.imu_hz', 300).successful
        robot.wait_for_health('the board cannot send 300 IMU', Level.WARN)
        refused = robot.graph.set_parameter('driver', 'driver.imu_hz', 100_000)
        assert not refused.successful and refused.reason
        refused = robot.graph.set_parameter('driver', 'driver.port', '/dev/ttyS0')
        assert not refused.successful and 'read-only' in refused.reason


def test_the_zero_can_be_measured_by_a_service(robot: Robot) -> None:
    robot.start()
    answer = robot.graph.trigger('driver/zero')
    assert not answer.success and 'not connected' in answer.message
    with BoardProgram(robot.port, '--scenario', 'standing'):
        robot.wait_for_imu()
        answer = robot.graph.trigger('driver/zero')
        assert answer.success and 'new zero' in answer.message


def test_an_invalid_parameter_ends_the_node_with_the_reason(robot: Robot) -> None:
    process = robot.graph.start('driver', parameters={'driver.imu_hz': 0})
    process.may_end = True
    robot.graph.wait(lambda: process.status is not None, 'the end of the node')
    assert process.status == 2
    assert 'error: ' in process.output and 'driver.imu_hz' in process.output
    assert 'Traceback' not in process.output


def test_the_node_ends_on_a_signal(robot: Robot) -> None:
    robot.start()
    with BoardProgram(robot.port, '--scenario', 'standing'):
        robot.wait_for_imu()
        [process] = robot.graph.processes
        assert process.stop() == 0
        assert 'Traceback' not in process.output
