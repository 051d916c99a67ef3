"""The node of an emulated ceiling camera, which belongs to the same emulated robot as the board emulator."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import rclpy
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from gyrocal_ros.config.declare import setting
from gyrocal_ros.data import Frame, nanoseconds, seconds
from gyrocal_ros.emulator.camera import EmulatedCamera, parse_camera_faults
from gyrocal_ros.msgs import images, to_ros, topics
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import IDENTITY
from gyrocal_ros.nodes.diagnostics import Diagnostics
from gyrocal_ros.nodes.endpoints import publish
from gyrocal_ros.nodes.params import Settings
from gyrocal_ros.nodes.qos import NO_EVENTS_OUT, SENSOR_OUT, STATIC
from gyrocal_ros.robot.health import Status, as_warnings, status
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

RECENT_S = 10.0
"""Time for which dropped images are reported."""


@dataclass(frozen=True, slots=True)
class CeilingConfig:
    """Settings of the emulated camera: those of the robot as for the board emulator, and the faults."""

    scenario: str = setting('cleaning', '', 'scenario of the drive, as in `gyrocal simulate`')
    seed: int = setting(0, '', 'seed of all random numbers', low=0, high=2**31 - 1)
    duration_s: float = setting(
        0.0, 's', 'duration of the drive; 0 for that of the scenario', low=0.0, high=7200.0
    )
    start_at: float = setting(
        0.0, 's', 'start of the drive, in seconds since 1970; 0 for now', low=0.0, high=1e11
    )
    troubles: str = setting(
        '',
        '',
        'faults of the camera: cover@, off@, clock@, freeze@ or lose@FROM+FOR, seconds from the start, '
        'separated by blanks',
    )


@dataclass(frozen=True, slots=True)
class CeilingSections:
    """Settings that only the ceiling emulator has."""

    ceiling: CeilingConfig = CeilingConfig()


class CeilingEmulatorNode:
    """The emulated camera; the node stays after the last image, because its transforms are still needed."""

    def __init__(self) -> None:
        self.node = node = rclpy.create_node('ceiling_emulator')
        config = Settings(node, CeilingSections(), ('ceiling',)).config.ceiling
        scenario = find_scenario(config.scenario)
        scenario = replace(scenario, duration_s=config.duration_s or scenario.duration_s)
        self._camera = EmulatedCamera(SimSource(scenario, config.seed), parse_camera_faults(config.troubles))
        self._camera.start_ns = nanoseconds(config.start_at) if config.start_at else time.time_ns()
        self._make = make = to_ros.live_maker(get_message)
        self._images = node.create_publisher(
            Image,
            Role.IMAGE,
            QoSProfile(depth=5),
            event_callbacks=NO_EVENTS_OUT,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self._infos = publish(node, CameraInfo, Role.CAMERA_INFO, SENSOR_OUT)
        self._truth = publish(node, Odometry, Role.TRUTH, SENSOR_OUT)
        self._transforms = publish(node, TFMessage, '/tf_static', STATIC)
        self._intrinsics, mount = self._camera.nominal
        mounts = {topics.CAMERA_FRAME: mount, topics.IMU_FRAME: IDENTITY}
        self._transforms.publish(to_ros.static_transforms(make, mounts, self._camera.start_ns))
        self._number = -1
        self._frame: Frame | None = None
        self._published = self._dropped = 0
        self._dropped_s = -RECENT_S
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(0.0, self._prepare, clock=steady)
        self._diagnostics = Diagnostics(node, self._status)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def _prepare(self) -> None:
        """Render the next image that is not late yet, ahead of its time, and wait for that time."""
        number = self._camera.next_after(self._number, time.time_ns())
        if number > self._number + 1 and self._published:
            self._dropped += number - self._number - 1
            self._dropped_s = time.monotonic()
        self._number = number
        if number == len(self._camera):
            self._timer.cancel()
            return
        self._frame = self._camera.take(number)
        self._call(self._publish, seconds(self._camera.due_ns(number) - time.time_ns()))

    def _publish(self) -> None:
        make, t_ns = self._make, self._camera.stamp_ns(self._number)
        if self._frame is not None:
            self._images.publish(images.grey_image(make, self._frame))
            self._infos.publish(to_ros.camera_info(make, self._intrinsics, t_ns))
            self._published += 1
        self._truth.publish(to_ros.truth(make, self._camera.truth(self._number)))
        self._call(self._prepare, 0.0)

    def _call(self, callback: Callable[[], None], wait_s: float) -> None:
        self._timer.callback = callback
        self._timer.timer_period_ns = nanoseconds(max(wait_s, 0.0))
        self._timer.reset()

    def _status(self) -> Status:
        left_s = seconds(self._camera.stamp_ns(len(self._camera) - 1) - time.time_ns())
        summary = (
            f'{self._published} images taken, {left_s:.0f} s to go' if left_s > 0.0 else 'the drive is over'
        )
        text = f'{self._dropped} images were dropped: the computer is too slow to render them in time'
        is_slow = time.monotonic() - self._dropped_s < RECENT_S
        return status(
            summary,
            as_warnings([text] if is_slow else []),
            {'images': self._published, 'left_out': self._dropped},
        )


make = CeilingEmulatorNode
