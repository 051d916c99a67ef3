"""A node that subscribes to the outputs of the others and collects them as plain values."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Thread

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import Image

from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs.images import jpeg
from gyrocal_ros.nodes.qos import LATCHED
from gyrocal_ros.robot.feed import Feed

IMAGE_EVERY_S = 0.5
"""Shortest time between two displayed images."""


class ListenerNode:
    """Subscribes to the calibration, the health of the nodes and the images with tracks."""

    def __init__(self, node: Node, feed: Feed) -> None:
        self._feed, self._shown_s = feed, 0.0
        node.create_subscription(ParameterEvent, 'gyro_calibration', self._on_calibration, LATCHED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_health, 10)
        node.create_subscription(Image, 'ceiling_camera/tracks_image', self._on_tracks, 1)

    def _on_calibration(self, message: ParameterEvent) -> None:
        parameters = [*message.new_parameters, *message.changed_parameters]
        values = {item.name: parameter_value_to_python(item.value) for item in parameters}
        self._feed.calibration(values, time.monotonic())

    def _on_health(self, message: DiagnosticArray) -> None:
        for status in message.status:
            numbers = {item.key: item.value for item in status.values}
            self._feed.health(status.name, status.level[0], status.message, numbers, time.monotonic())

    def _on_tracks(self, message: Image) -> None:
        now_s = time.monotonic()
        if now_s - self._shown_s < IMAGE_EVERY_S:
            return
        self._shown_s = now_s
        try:
            self._feed.tracks(jpeg(message))
        except RecordingError as error:
            self._feed.health('tracks_image', 2, str(error), {}, now_s)


@contextmanager
def listening(namespace: str = '', domain: int | None = None) -> Iterator[Feed]:
    """Collect the outputs of the nodes, in a thread that runs as long as the context.

    Args:
        namespace: namespace of the robot.
        domain: ROS_DOMAIN_ID; None for that of the environment.
    """
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node(f'gyrocal_studio_{os.getpid()}', context=context, namespace=namespace)
    feed = Feed(time.monotonic())
    listener = ListenerNode(node, feed)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = Thread(target=spin, name='listener', daemon=True)
    thread.start()
    try:
        yield feed
    finally:
        executor.shutdown()
        rclpy.try_shutdown(context=context)
        thread.join(5.0)
        node.destroy_node()
        del listener
