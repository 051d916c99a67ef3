"""An executor of low cost, for nodes with hundreds of messages a second.

That of rclpy makes a wait set, a task and two coroutines for every callback, and wakes itself after it to
begin again. The wait set and the handles are not documented by rclpy: they are as in ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

FOREVER_NS = -1


class LeanExecutor(SingleThreadedExecutor):
    """Serves timers, subscriptions and services, whose callbacks are functions, in one thread.

    Nothing else is served: neither clients nor QoS events, which the nodes here do not use.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        self._served: _Served | None = None
        super().__init__(context=context)

    def wake(self) -> None:
        """Take notice of entities that were made or destroyed."""
        self._served = None
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Serve a node."""
        self._served = None
        return bool(super().add_node(node))

    def remove_node(self, node: Node) -> None:
        """Serve a node no longer."""
        self._served = None
        super().remove_node(node)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is ready, and call the callbacks of all that is."""
        guards = self._guard, self._sigint_gc
        served = self._served = self._served or _Served(self.get_nodes(), guards, self.context)
        served.wait(FOREVER_NS if timeout_sec is None else int(1e9 * timeout_sec))
        for serve, entity in served.ready():
            serve(entity)
            if self._served is not served:  # an entity may be gone; what was not served stays ready
                return


class _Served:
    """Everything that some nodes wait for, with one wait set for all times."""

    def __init__(self, nodes: list[Node], guards: tuple[Any, ...], context: Context) -> None:
        timers = _by_address(timer for node in nodes for timer in node.timers)
        subscriptions = _by_address(item for node in nodes for item in node.subscriptions)
        services = _by_address(service for node in nodes for service in node.services)
        sizes = len(subscriptions), len(guards), len(timers), 0, len(services), 0  # no clients, no events
        self._wait_set = wait_set = rclpy_implementation.WaitSet(*sizes, context.handle)
        self._adds = [
            (add, entity.handle)
            for add, entities in (
                (wait_set.add_guard_condition, guards),
                (wait_set.add_timer, timers.values()),
                (wait_set.add_subscription, subscriptions.values()),
                (wait_set.add_service, services.values()),
            )
            for entity in entities
        ]
        self._kinds: tuple[tuple[str, Callable[[Any], None], dict[int, Any]], ...] = (
            ('timer', _call, timers),
            ('subscription', _deliver, subscriptions),
            ('service', _answer, services),
        )

    def wait(self, timeout_ns: int) -> None:
        """Wait until something is ready."""
        self._wait_set.clear_entities()
        for add, handle in self._adds:
            add(handle)
        self._wait_set.wait(timeout_ns)

    def ready(self) -> Iterator[tuple[Callable[[Any], None], Any]]:
        """Yield what is ready, in the order of serving, each with the function that serves it."""
        for kind, serve, entities in self._kinds:
            for address in self._wait_set.get_ready_entities(kind):
                yield serve, entities[address]


def _by_address(entities: Iterable[Any]) -> dict[int, Any]:
    """Return the entities whose callbacks may be called, by address."""
    return {item.handle.pointer: item for item in entities if item.callback_group.can_execute(item)}


def _call(timer: Timer) -> None:
    if timer.handle.is_timer_ready():  # no longer, where a callback has cancelled it
        timer.handle.call_timer()
        timer.callback()


def _deliver(subscription: Subscription) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        has_info = subscription._callback_type is not Subscription.CallbackType.MessageOnly
        subscription.callback(*(taken if has_info else taken[:1]))


def _answer(service: Service) -> None:
    request, header = service.handle.service_take_request(service.srv_type.Request)
    if header is not None:
        service.send_response(service.callback(request, service.srv_type.Response()), header)
