"""The tracker node: tracks features in the images of the ceiling."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from tf2_msgs.msg import TFMessage

from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import seconds
from gyrocal_ros.msgs import clouds, images, to_ros, topics
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.diagnostics import Diagnostics
from gyrocal_ros.nodes.endpoints import polled_subscription, publish, subscribe, take_messages
from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.image_subscription import ImageSubscription
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT, STATIC
from gyrocal_ros.robot.health import Status
from gyrocal_ros.robot.tracking import LiveTracker, Tracked

REGIONS = 'ceiling_camera/search_regions'
POLL_S, FAST_POLL_S = 0.1, 0.002
"""Periods of polling the IMU, usually and while an image waits for it."""
MAX_QUEUED_S = 1.0
"""Longest plausible time of an image in the queue of the middleware."""


class TrackerNode:
    """The tracker node; a `LiveTracker` does the work."""

    def __init__(self) -> None:
        self.node = node = rclpy.create_node('tracker')
        self._config = Settings(node, Config(), ('tracker', 'camera'), self._configure)
        self._robot = Settings(node, RobotConfig(), ('images',), self._configure)
        config, self._settings = self._config.config, self._robot.config.images
        self._live = LiveTracker(config.tracker, config.camera, self._settings.patience_s, time.monotonic())
        self._make = to_ros.live_maker(get_message)
        self._camera_frame = topics.CAMERA_FRAME
        self._features = publish(node, PointCloud2, Role.FEATURES, SENSOR_OUT)
        self._tracks = publish(node, Image, 'ceiling_camera/tracks_image', QoSProfile(depth=1))
        self._imu = polled_subscription(node, Imu, Role.IMU, SENSOR_IN)
        guard = Guard(node, self._live.health.log.add_unusable)
        for kind, topic, callback, qos in (
            (CameraInfo, Role.CAMERA_INFO, self._on_camera, SENSOR_IN),
            (TFMessage, '/tf_static', self._on_transforms, STATIC),
            (PointCloud2, REGIONS, self._on_regions, SENSOR_IN),
        ):
            subscribe(node, kind, topic, guard(topic, callback), qos)
        on_image = guard(Role.IMAGE, self._on_image)
        work = guard('the timer', self._work)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(POLL_S, work, clock=steady)
        self._fast_poll = node.create_timer(FAST_POLL_S, work, clock=steady)
        self._fast_poll.cancel()
        self._images = ImageSubscription(node, lambda: self._robot.config.images.transport, on_image)
        self._diagnostics = Diagnostics(node, self._status)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def _configure(self, _: Any) -> None:
        self._live.configure(self._config.config.tracker, self._robot.config.images.patience_s)

    def _status(self) -> Status:
        return self._live.status(time.monotonic())

    # --- input ------------------------------------------------------------------------------------

    def _on_image(self, message: Any, info: Any) -> None:
        queued_s = seconds(
            time.time_ns() - info['received_timestamp']
        )  # implausible where the middleware has none
        arrival_s = time.monotonic() - (queued_s if 0.0 < queued_s < MAX_QUEUED_S else 0.0)
        frame = images.frame(message)
        self._camera_frame = message.header.frame_id
        self._poll_imu()
        self._live.image(frame, self._camera_frame, arrival_s)
        self._work()

    def _poll_imu(self) -> None:
        for message in take_messages(self._imu):
            self._live.imu(topics.IMU_SAMPLE.value(message), message.header.frame_id, time.monotonic())

    def _on_regions(self, message: PointCloud2) -> None:
        self._live.regions(clouds.search_regions(message), time.monotonic())
        self._work()

    def _on_camera(self, message: CameraInfo) -> None:
        camera = topics.camera_intrinsics(message)
        self._live.camera(camera, message.header.frame_id, time.monotonic())

    def _on_transforms(self, message: TFMessage) -> None:
        self._live.transforms(topics.transforms(message))

    # --- output -----------------------------------------------------------------------------------

    def _work(self) -> None:
        self._poll_imu()
        while (tracked := self._live.work(time.monotonic())) is not None:
            self._publish(tracked)
        if self._live.is_waiting == self._fast_poll.is_canceled():
            (self._fast_poll.reset if self._live.is_waiting else self._fast_poll.cancel)()

    def _publish(self, tracked: Tracked) -> None:
        self._features.publish(to_ros.features(self._make, tracked.seen, self._camera_frame))
        self._live.health.add_latency(time.monotonic() - tracked.arrival_s)
        if self._tracks.get_subscription_count():
            frame = tracked.frame
            self._tracks.publish(
                images.colour_image(self._make, frame.t_ns, self._camera_frame, tracked.picture())
            )


make = TrackerNode
