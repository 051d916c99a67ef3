"""The executor of the nodes: what it serves, and what may change while it does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from threading import Timer as Later

import pytest
import rclpy
from graph import WITHIN_S, Graph
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from gyrocal_ros.nodes.endpoints import polled_subscription, take_messages
from gyrocal_ros.nodes.executor import LeanExecutor

PERIOD_S = 0.01


class Served:
    """A node that the executor serves, beside the node of the test."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.node = Node('served', context=graph.node.context)
        self.executor = LeanExecutor(context=graph.node.context)
        self.executor.add_node(self.node)

    def until(self, condition: Callable[[], object]) -> None:
        """Serve both nodes until a condition is true."""
        end_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < end_s
            self.executor.spin_once(PERIOD_S)
            self.graph.spin(0.0)


@pytest.fixture
def served() -> Iterator[Served]:
    with Graph() as graph:
        served = Served(graph)
        yield served
        served.executor.remove_node(served.node)
        served.executor.shutdown()
        served.node.destroy_node()


def test_messages_come_in_order_and_with_their_info(served: Served) -> None:
    plain: list[float] = []
    informed: list[tuple[float, int]] = []
    served.node.create_subscription(Float64, 'a', lambda message: plain.append(message.data), 10)
    served.node.create_subscription(
        Float64, 'a', lambda message, info: informed.append((message.data, info['source_timestamp'])), 10
    )
    publisher = served.graph.publisher(Float64, 'a', readers=2)
    for value in range(5):
        publisher.publish(Float64(data=float(value)))
    served.until(lambda: len(plain) == len(informed) == 5)
    assert plain == [value for value, _ in informed] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert all(stamp > 0 for _, stamp in informed)


def test_a_polled_subscription_is_left_alone(served: Served) -> None:
    polled = polled_subscription(served.node, Float64, 'a', 10)
    publisher = served.graph.publisher(Float64, 'a')
    publisher.publish(Float64(data=1.0))
    start_s = time.monotonic()
    for _ in range(5):
        served.executor.spin_once(10 * PERIOD_S)
    assert time.monotonic() - start_s > 20 * PERIOD_S, 'its message does not end the wait'
    assert [message.data for message in take_messages(polled)] == [1.0]


def test_timers_are_called_until_they_are_cancelled(served: Served) -> None:
    calls: list[str] = []

    def first() -> None:
        calls.append('first')
        second.cancel()

    served.node.create_timer(PERIOD_S, first)
    second = served.node.create_timer(PERIOD_S, lambda: calls.append('second'))
    time.sleep(3 * PERIOD_S)  # both are due at the first wait
    served.until(lambda: len(calls) >= 3)
    assert set(calls) == {'first'}


def test_entities_may_come_and_go_within_callbacks(served: Served) -> None:
    received: list[float] = []

    def replace() -> None:
        timer.cancel()
        served.node.destroy_subscription(old)
        served.node.create_subscription(Float64, 'b', lambda message: received.append(message.data), 10)

    old = served.node.create_subscription(Float64, 'a', lambda message: received.append(-1.0), 10)
    publisher = served.graph.publisher(Float64, 'a')
    timer = served.node.create_timer(PERIOD_S, replace)
    publisher.publish(Float64(data=1.0))
    time.sleep(3 * PERIOD_S)  # timer and message are ready at once, and the timer comes first
    served.until(timer.is_canceled)
    other = served.graph.node.create_publisher(Float64, 'b', 10)
    served.until(lambda: other.get_subscription_count())
    other.publish(Float64(data=2.0))
    served.until(lambda: received)
    assert received == [2.0]


def test_services_answer(served: Served) -> None:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, 'done'
        return response

    served.node.create_service(Trigger, 'act', answer)
    client = served.graph.node.create_client(Trigger, 'act')
    served.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    served.until(future.done)
    assert future.result().message == 'done'


def test_it_ends_with_its_context() -> None:
    context = Context()
    rclpy.init(context=context)
    node = Node('served', context=context)
    executor = LeanExecutor(context=context)
    executor.add_node(node)
    Later(0.2, context.shutdown).start()
    executor.spin()  # returns
    assert not context.ok()
    node.destroy_node()


def test_errors_of_callbacks_are_raised(served: Served) -> None:
    def fail() -> None:
        raise ValueError('by the callback')

    served.node.create_timer(PERIOD_S, fail)
    with pytest.raises(ValueError, match='by the callback'):
        served.until(lambda: False)
