"""Subscriptions whose messages are delivered in the order of their stamps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial

import pytest
from builtin_interfaces.msg import Time
from graph import Graph
from rclpy.publisher import Publisher
from sensor_msgs.msg import Imu, Temperature
from std_msgs.msg import Header

from gyrocal_ros.nodes.endpoints import SortedSubscriptions
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT

KINDS = {'fast': Imu, 'slow': Temperature}
Received = list[tuple[str, int]]


@pytest.fixture
def graph() -> Iterator[Graph]:
    with Graph() as graph:
        yield graph


@pytest.fixture
def received(graph: Graph) -> Received:
    """Topic and stamp (s) of the messages in the order of their delivery."""
    received: Received = []
    sorted_ones = SortedSubscriptions(graph.node, SENSOR_IN)
    for topic, kind in KINDS.items():

        def take(topic: str, message: Imu | Temperature) -> None:
            received.append((topic, message.header.stamp.sec))

        sorted_ones.subscribe(kind, topic, partial(take, topic))
    return received


@pytest.fixture
def publishers(graph: Graph, received: Received) -> dict[str, Publisher]:
    return {topic: graph.publisher(kind, topic, SENSOR_OUT) for topic, kind in KINDS.items()}


def send(publishers: dict[str, Publisher], topic: str, second: int) -> None:
    publishers[topic].publish(KINDS[topic](header=Header(stamp=Time(sec=second))))


def test_what_waits_after_a_pause_is_sorted(
    graph: Graph, received: Received, publishers: dict[str, Publisher]
) -> None:
    for second in (1, 2, 3, 4):
        send(publishers, 'fast', second)
    for second in (2, 4):
        send(publishers, 'slow', second)
    time.sleep(0.2)
    graph.wait(lambda: len(received) == 6, 'all messages')
    assert received == [('fast', 1), ('fast', 2), ('slow', 2), ('fast', 3), ('fast', 4), ('slow', 4)]


def test_single_messages_are_delivered_as_they_come(
    graph: Graph, received: Received, publishers: dict[str, Publisher]
) -> None:
    def has_come(number: int) -> bool:
        return len(received) == number

    for number, (topic, second) in enumerate((('slow', 5), ('fast', 4), ('slow', 3), ('fast', 6)), 1):
        send(publishers, topic, second)
        graph.wait(partial(has_come, number), 'the message')
    assert received == [('slow', 5), ('fast', 4), ('slow', 3), ('fast', 6)]
