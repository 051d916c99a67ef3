"""The driver node: publishes the measurements of the board."""

from __future__ import annotations

from contextlib import suppress

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import BatteryState, Imu, Temperature
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from gyrocal_ros.board.convert import SupplySample
from gyrocal_ros.board.reader import Reading, WheelMotion
from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.data import ImuSample, TemperatureSample
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.msgs import to_ros
from gyrocal_ros.nodes.diagnostics import Diagnostics
from gyrocal_ros.nodes.guard import Guard
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.qos import SENSOR_OUT
from gyrocal_ros.robot.board_driver import BoardDriver

TRANSFORMS = QoSProfile(depth=100)
"""QoS of /tf, as in tf2."""
NO_READING = ImuSample(0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class DriverNode:
    """The driver node; a `BoardDriver` publishes in its own thread."""

    def __init__(self) -> None:
        self.node = Node('driver')
        sections = ('board', 'board_limits', 'driver', 'messages')
        settings = Settings(self.node, RobotConfig(), sections, self._configure)
        board, driver = settings.config.board, settings.config.driver
        self._messages = settings.config.messages
        self._make = to_ros.live_maker(get_message)
        self._imu_message = to_ros.imu(self._make, NO_READING, self._messages)
        self._imu = self.node.create_publisher(Imu, 'imu/data_raw', SENSOR_OUT)
        self._temperature = self.node.create_publisher(Temperature, 'imu/temperature', SENSOR_OUT)
        self._odometry = self.node.create_publisher(Odometry, 'wheel/odometry', SENSOR_OUT)
        self._battery = self.node.create_publisher(BatteryState, 'battery_state', SENSOR_OUT)
        self._transforms = (
            self.node.create_publisher(TFMessage, '/tf', TRANSFORMS)
            if driver.publish_odom_transform
            else None
        )
        self._board = BoardDriver(board, driver, self._now_ns, self._publish, settings.config.board_limits)
        guard = Guard(self.node, self._board.add_unpublished)
        self._guarded_send = guard('the readings of the board', self._send)
        self._diagnostics = Diagnostics(self.node, self._board.status)
        self.node.create_service(Trigger, '~/zero', guard.service('~/zero', self._zero))
        self._board.start()

    def close(self) -> None:
        """Close the port."""
        self._board.close()

    def _now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _configure(self, config: RobotConfig) -> None:
        self._board.set_rates(config.driver)

    def _publish(self, reading: Reading) -> None:
        with suppress(Exception):  # only raised where the node was shut down while it published
            self._guarded_send(reading)

    def _send(self, reading: Reading) -> None:
        if isinstance(reading, ImuSample):
            to_ros.set_imu(self._imu_message, reading)
            self._imu.publish(self._imu_message)  # which serialises it at once
        elif isinstance(reading, WheelMotion):
            self._send_wheels(reading)
        elif isinstance(reading, SupplySample):
            numbers = {'voltage': reading.voltage_v, 'current': reading.current_a}
            self._battery.publish(to_ros.battery(self._make, reading.t_ns, numbers))
        elif isinstance(reading, TemperatureSample):
            self._temperature.publish(to_ros.temperature(self._make, reading, self._messages))

    def _send_wheels(self, motion: WheelMotion) -> None:
        pose, t_ns = motion.pose, motion.sample.t_ns
        planar_pose = pose.x_m, pose.y_m, pose.yaw_rad
        message = to_ros.wheels(
            self._make,
            motion.sample,
            *planar_pose,
            travelled_m=pose.travelled_m,
            turned_rad=pose.turned_rad,
            config=self._messages,
        )
        self._odometry.publish(message)
        if self._transforms:
            self._transforms.publish(
                to_ros.odometry_transform(self._make, t_ns, *planar_pose, self._messages)
            )

    def _zero(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Wait for the board to measure its zero; its thread keeps publishing meanwhile."""
        try:
            self._board.zero()
        except GyrocalError as error:
            response.success, response.message = False, str(error)
        else:
            response.success = True
            response.message = 'the board has a new zero; the bias estimated before is no longer valid'
        return response


make = DriverNode
