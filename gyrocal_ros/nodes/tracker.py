"""The tracker: images of the ceiling become lists of features."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, PointCloud2
from tf2_msgs.msg import TFMessage

from gyrocal_ros.config.sections import Config, RobotConfig
from gyrocal_ros.data import seconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import images, to_ros, topics
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.diagnostics import Diagnostics
from gyrocal_ros.nodes.endpoints import mailbox, publish, subscribe, waiting
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT, STATIC
from gyrocal_ros.robot.health import Status
from gyrocal_ros.robot.tracking import LiveTracker, Tracked

COMPRESSED = 'compressed'
TRANSPORTS = {'raw': ('', Image), COMPRESSED: (f'/{COMPRESSED}', CompressedImage)}
"""What follows the name of the images' topic, and their type."""
IMAGES_HELD = 2
"""Of images that come faster than they can be followed, these are the latest."""
FETCH_S, WAKE_S, LOOK_S = 0.1, 0.002, 0.5
"""How often the IMU is heard at least, and how often while an image waits for it; how often images are
looked for."""
QUEUED_S = 1.0
"""An image does not wait longer than this to be heard."""


class TrackerNode:
    """The node."""

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
        self._images: Subscription | None = None
        self._imu = mailbox(node, Imu, Role.IMU, SENSOR_IN)
        subscribe(node, CameraInfo, Role.CAMERA_INFO, self._hear_camera, SENSOR_IN)
        subscribe(node, TFMessage, '/tf_static', self._hear_links, STATIC)
        subscribe(node, PointCloud2, 'ceiling_camera/search_regions', self._hear_regions, SENSOR_IN)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(FETCH_S, self._follow, clock=steady)
        self._wake = node.create_timer(WAKE_S, self._follow, clock=steady)
        self._wake.cancel()
        self._look = node.create_timer(LOOK_S, self._look_for_images, clock=steady)
        self._diagnostics = Diagnostics(node, self._status)

    def close(self) -> None:
        """Nothing has to be put in order."""

    def _configure(self, _: Any) -> None:
        self._live.configure(self._config.config.tracker, self._robot.config.images.patience_s)

    def _status(self) -> Status:
        return self._live.status(time.monotonic())

    def _look_for_images(self) -> None:
        """Subscribe to the images that are published, as reliably as they are."""
        wanted = self._robot.config.images.transport
        name = self.node.resolve_topic_name(Role.IMAGE)
        for transport, (ending, kind) in TRANSPORTS.items():
            offered = self.node.get_publishers_info_by_topic(name + ending)
            if offered and wanted in ('auto', transport):
                reliable = all(o.qos_profile.reliability is ReliabilityPolicy.RELIABLE for o in offered)
                policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
                qos = QoSProfile(depth=IMAGES_HELD, reliability=policy)
                self._images = subscribe(self.node, kind, name + ending, self._hear_image, qos)
                self.node.get_logger().info(f'following {name + ending}')
                self._look.cancel()
                return

    # --- what comes in ---------------------------------------------------------------------------

    def _hear_image(self, message: Any, info: Any) -> None:
        waited_s = seconds(time.time_ns() - info['received_timestamp'])  # odd where the middleware tells none
        came_s = time.monotonic() - (waited_s if 0.0 < waited_s < QUEUED_S else 0.0)
        try:
            frame = images.frame(message)
        except RecordingError as error:
            self._live.health.spoil(f'{error.what}; {error.todo}')
            return
        self._camera_frame = message.header.frame_id
        self._fetch_imu()
        self._live.image(frame, self._camera_frame, came_s)
        self._follow()

    def _fetch_imu(self) -> None:
        for message in waiting(self._imu):
            self._live.imu(topics.IMU_SAMPLE.value(message), message.header.frame_id, time.monotonic())

    def _hear_regions(self, message: PointCloud2) -> None:
        self._live.regions(topics.search_regions(message), time.monotonic())
        self._follow()

    def _hear_camera(self, message: CameraInfo) -> None:
        try:
            camera = topics.camera_intrinsics(message)
        except RecordingError as error:
            self._live.health.happened(f'{Role.CAMERA_INFO}: {error}', time.monotonic())
            return
        self._live.camera(camera, message.header.frame_id, time.monotonic())

    def _hear_links(self, message: TFMessage) -> None:
        self._live.links(topics.transforms(message))

    # --- what goes out ---------------------------------------------------------------------------

    def _follow(self) -> None:
        self._fetch_imu()
        while (tracked := self._live.work(time.monotonic())) is not None:
            self._publish(tracked)
        if self._live.is_waiting == self._wake.is_canceled():
            (self._wake.reset if self._live.is_waiting else self._wake.cancel)()

    def _publish(self, tracked: Tracked) -> None:
        self._features.publish(to_ros.features(self._make, tracked.seen, self._camera_frame))
        self._live.health.hand_on(time.monotonic() - tracked.came_s)
        if self._tracks.get_subscription_count():
            frame = tracked.frame
            self._tracks.publish(
                images.colour_image(self._make, frame.t_ns, self._camera_frame, tracked.picture())
            )


def make() -> TrackerNode:
    """Start the node."""
    return TrackerNode()
