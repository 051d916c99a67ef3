"""No error in a callback ends a node: it is counted, and the next message is processed."""

from __future__ import annotations

import time
from typing import Any

import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from gyrocal_ros.errors import MessageError  # noqa: E402
from gyrocal_ros.nodes.endpoints import subscribe  # noqa: E402
from gyrocal_ros.nodes.guard import Guard  # noqa: E402
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT  # noqa: E402

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
