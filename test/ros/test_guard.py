"""No error in a callback ends a node: it is counted, and the next message is processed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from gyrocal_ros.errors import MessageError  # noqa: E402
from gyrocal_ros.nodes.diagnostics import Diagnostics  # noqa: E402
from gyrocal_ros.nodes.endpoints import subscribe  # noqa: E402
from gyrocal_ros.nodes.guard import Guard  # noqa: E402
from gyrocal_ros.nodes.qos import LATCHED, SENSOR_IN, SENSOR_OUT  # noqa: E402
from gyrocal_ros.nodes.qos_watch import incompatible_endpoints  # noqa: E402
from gyrocal_ros.robot.health import Level, Status  # noqa: E402

PATIENCE_S = 20.0
ERRORS = {'message': MessageError('no u', todo='add u'), 'defect': ZeroDivisionError('of x')}


def test_a_callback_that_raises_is_counted_and_called_again() -> None:
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('guarded', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    counted: list[tuple[str, str]] = []
    received: list[str] = []

    def callback(message: String, info: Any) -> None:
        received.append(message.data)
        assert 'received_timestamp' in info
        if message.data in ERRORS:
            raise ERRORS[message.data]

    guard = Guard(node, lambda topic, why: counted.append((topic, why)))
    subscribe(node, String, 'words', guard('words', callback), SENSOR_IN)
    publisher = node.create_publisher(String, 'words', SENSOR_OUT)
    try:
        while not publisher.get_subscription_count():
            executor.spin_once(0.05)
        for word in ('message', 'defect', 'last'):
            publisher.publish(String(data=word))
        end_s = time.monotonic() + 20.0
        while 'last' not in received and time.monotonic() < end_s:
            executor.spin_once(0.05)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
    assert received == ['message', 'defect', 'last']
    assert [topic for topic, _ in counted] == ['words', 'words']
    assert 'add u' in counted[0][1]
    assert 'of x' in counted[1][1]


@contextmanager
def node_and_executor() -> Iterator[tuple[Any, SingleThreadedExecutor]]:
    """Make a node in a context of its own."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node('guarded', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_a_service_that_raises_answers_with_the_reason() -> None:
    def fail(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        raise OSError('no space')

    counted: list[str] = []
    with node_and_executor() as (node, _):
        answer = Guard(node, lambda topic, why: counted.append(topic)).service('~/save', fail)
        response = answer(Trigger.Request(), Trigger.Response())
    assert not response.success and 'no space' in response.message
    assert counted == ['~/save']


def test_a_status_that_cannot_be_determined_is_an_error() -> None:
    received: list[DiagnosticArray] = []

    def fail() -> Status:
        raise ZeroDivisionError('of x')

    with node_and_executor() as (node, executor):
        node.create_subscription(DiagnosticArray, '/diagnostics', received.append, 10)
        diagnostics = Diagnostics(node, fail)
        end_s = time.monotonic() + PATIENCE_S
        while len(received) < 2 and time.monotonic() < end_s:
            executor.spin_once(0.1)
        del diagnostics
    assert len(received) == 2, 'the timer goes on'
    assert received[0].status[0].level == bytes([Level.ERROR])
    assert 'of x' in received[0].status[0].message


def test_endpoints_that_cannot_be_connected_are_named() -> None:
    with node_and_executor() as (node, executor):
        other = rclpy.create_node('other', context=node.context)
        node.create_subscription(String, 'wanted', print, LATCHED)
        other.create_publisher(String, 'wanted', SENSOR_OUT)
        other.create_subscription(String, 'offered', print, LATCHED)
        node.create_publisher(String, 'offered', SENSOR_OUT)
        node.create_subscription(String, 'stream', print, SENSOR_IN)
        other.create_publisher(String, 'stream', SENSOR_OUT)
        end_s, found = time.monotonic() + PATIENCE_S, list[str]()
        while len(found) < 2 and time.monotonic() < end_s:
            executor.spin_once(0.1)
            found = list(incompatible_endpoints(node))
        other.destroy_node()
    assert len(found) == 2
    assert found[0].startswith('/offered: the subscriber other has an incompatible QoS')
    assert found[1].startswith('/wanted: the publisher other has an incompatible QoS')
