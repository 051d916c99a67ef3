"""The calibrator node: estimates and applies the calibration while the robot drives."""

from __future__ import annotations

import time

import rclpy
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2, Temperature
from tf2_msgs.msg import TFMessage

from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import CovariateSample
from gyrocal_ros.effects.model_file import load_model_with_effects
from gyrocal_ros.effects.traits import followers_by_signal
from gyrocal_ros.msgs import clouds, outputs, to_ros, topics
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.nodes.calibration_publisher import CalibrationPublisher
from gyrocal_ros.nodes.calibrator_services import CalibratorServices
from gyrocal_ros.nodes.diagnostics import Diagnostics
from gyrocal_ros.nodes.endpoints import SortedSubscriptions, publish, subscribe
from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.map_frame import MapFrame
from gyrocal_ros.nodes.map_publisher import MapPublisher
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.qos import SENSOR_IN, SENSOR_OUT, STATIC
from gyrocal_ros.nodes.reference import ReferenceSubscription
from gyrocal_ros.nodes.signals import Signals
from gyrocal_ros.robot.calibrator import LiveCalibrator
from gyrocal_ros.robot.health import Status

SECTIONS = ('gyro', 'wheels', 'camera', 'features', 'rest', 'convergence')
"""Sections of the estimator's settings that are parameters of this node."""


class CalibratorNode:
    """The calibrator node; a `LiveCalibrator` does the work."""

    def __init__(self) -> None:
        self.node = node = rclpy.create_node('calibrator')
        self._config = Settings(node, Config(), SECTIONS, self._configure)
        self._robot = Settings(node, RobotConfig(), ('live',), self._configure)
        live = self._robot.config.live
        model = load_model_with_effects(live.model, live.effects_from)
        self._live = LiveCalibrator(
            model,
            self._config.config,
            live,
            name=node.get_fully_qualified_name(),
            steady=not node.get_parameter('use_sim_time').value,
            now_s=time.monotonic(),
        )
        self._make = to_ros.live_maker(get_message)
        self._publisher = CalibrationPublisher(node, self._make, self._live.calibration)
        self._map_frame = MapFrame(node, self._make) if live.publishes_map else None
        self._odom, self._body, self._map = topics.ODOM_FRAME, topics.BODY_FRAME, topics.MAP_FRAME
        self._imu = publish(node, Imu, 'imu/data', SENSOR_OUT)
        self._odometry = publish(node, Odometry, 'odometry/slam', SENSOR_OUT)
        self._regions = publish(node, PointCloud2, 'ceiling_camera/search_regions', SENSOR_OUT)
        self._map_publisher = MapPublisher(node, self._make)
        guard = Guard(node, self._live.unusable)
        sensors = SortedSubscriptions(node, SENSOR_IN)
        sensors.subscribe(Imu, Role.IMU, guard(Role.IMU, self._on_imu))
        sensors.subscribe(Odometry, Role.WHEELS, guard(Role.WHEELS, self._on_wheels))
        sensors.subscribe(PointCloud2, Role.FEATURES, guard(Role.FEATURES, self._on_features))
        sensors.subscribe(Temperature, Role.TEMPERATURE, guard(Role.TEMPERATURE, self._on_temperature))
        on_camera = guard(Role.CAMERA_INFO, self._on_camera)
        subscribe(node, CameraInfo, Role.CAMERA_INFO, on_camera, SENSOR_IN)
        node.create_subscription(TFMessage, '/tf_static', guard('/tf_static', self._on_transforms), STATIC)
        followers = followers_by_signal(model)
        self._signals = Signals(node, followers, lambda: self._live.newest_ns, self._on_signal, guard)
        named, take = live.heading_reference, self._live.heading
        self._reference = ReferenceSubscription(node, sensors, named, take, guard)
        CalibratorServices(node, self._live, guard)
        # By the steady clock: the calibration is also published and saved while simulated time is paused.
        every_second = guard('the timer', self._every_second)
        node.create_timer(1.0, every_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        Diagnostics(node, self._status)

    def close(self) -> None:
        """Process what still waits, and save the calibration."""
        self._live.close()

    def _on_imu(self, message: Imu) -> None:
        frame = message.header.frame_id.lstrip('/')
        sample = self._live.imu(topics.IMU_SAMPLE.value(message), frame, time.monotonic())
        if sample is not None:
            self._imu.publish(outputs.calibrated_imu(self._make, sample, self._body))
        self._work()

    def _on_wheels(self, message: Odometry) -> None:
        estimate = self._live.wheels(topics.WHEEL_SAMPLE.value(message), time.monotonic())
        if message.header.frame_id != self._odom:
            self._odom, self._body = message.header.frame_id, message.child_frame_id
            self._map = topics.map_frame(self._odom)
        if estimate is not None:
            self._odometry.publish(outputs.odometry_estimate(self._make, estimate, self._map, self._body))
            if self._map_frame is not None:
                self._map_frame.send(estimate, topics.body_pose(message), self._map, self._odom)
        self._work()

    def _on_features(self, message: PointCloud2) -> None:
        seen = clouds.features(message)
        self._live.features(seen, message.header.frame_id.lstrip('/'), time.monotonic())
        self._work()

    def _on_temperature(self, message: Temperature) -> None:
        self._live.temperature(topics.TEMPERATURE_SAMPLE.value(message), time.monotonic())

    def _on_signal(self, sample: CovariateSample) -> None:
        self._live.signal(sample, time.monotonic())

    def _on_camera(self, message: CameraInfo) -> None:
        camera = topics.camera_intrinsics(message)
        self._live.camera(camera, message.header.frame_id.lstrip('/'), time.monotonic())

    def _on_transforms(self, message: TFMessage) -> None:
        self._live.transforms(topics.transforms(message))
        if self._map_frame is not None:
            self._map_frame.add_received(message, is_static=True)

    def _work(self) -> None:
        """Let the filter take at most one step, so that the next IMU sample need not wait for long."""
        if (regions := self._live.work()) is not None:
            self._regions.publish(to_ros.search_regions(self._make, regions))

    def _every_second(self) -> None:
        self._publisher.update(self._live.calibration)
        self._live.save_if_due(time.monotonic())
        self._signals.poll()
        self._reference.poll()
        if self._map_frame is not None:
            self._map_frame.poll()
        if self._map_publisher.is_wanted and (points := self._live.ceiling_map()):
            self._map_publisher.publish(points, self._map)

    def _status(self) -> Status:
        map_problem = self._map_frame.problem if self._map_frame else ''
        return self._live.status(time.monotonic(), self._reference.problem, map_problem)

    def _configure(self, _: Config | RobotConfig) -> None:
        self._live.configure(self._config.config, self._robot.config.live)


make = CalibratorNode
