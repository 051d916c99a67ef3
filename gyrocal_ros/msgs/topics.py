"""Topics of a robot, and conversion of their messages to the values of `data`.

The inverse conversion is `to_ros`; no other room knows the layout of these messages. Messages of rosbags
and of rclpy have the same attributes, so the conversions work for bags and for live nodes, and need no
ROS installation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import StrEnum
from itertools import repeat
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np

from gyrocal_ros.data import (
    NS_PER_S,
    CameraIntrinsics,
    ImuSample,
    Mount,
    TemperatureSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import MessageError
from gyrocal_ros.model.lens import COEFFICIENT_COUNTS
from gyrocal_ros.msgs.plausible import IMU_BOUNDS, MAX_DISTANCE_M, MAX_READING, WHEEL_BOUNDS
from gyrocal_ros.msgs.transforms import (
    Transform,
    rotation_from_quaternion,
    yaw_from_quaternion,
)

MAP_FRAME, ODOM_FRAME, BODY_FRAME, IMU_FRAME = 'map', 'odom', 'base_link', 'imu_link'
CAMERA_FRAME = 'ceiling_camera_optical_frame'
STATIC_TRANSFORMS = 'tf_static'

IMU = 'sensor_msgs/msg/Imu'
ODOMETRY = 'nav_msgs/msg/Odometry'
TEMPERATURE = 'sensor_msgs/msg/Temperature'
IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
POINT_CLOUD = 'sensor_msgs/msg/PointCloud2'
BATTERY = 'sensor_msgs/msg/BatteryState'
NUMBER = 'std_msgs/msg/Float64'
TRANSFORMS = 'tf2_msgs/msg/TFMessage'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
POSES = {
    ODOMETRY: 'pose.pose',
    POSE_STAMPED: 'pose',
    'geometry_msgs/msg/PoseWithCovarianceStamped': 'pose.pose',
}
"""Message types that contain a pose, with the dotted name of the pose."""


MAX_INTRINSIC = 1e6
"""Largest plausible number in camera_info, pixels or distortion."""
FOCAL_LENGTHS = (0.05, 50.0)
"""Bounds of a focal length, in widths or heights of the image, the larger one: fisheye to telescope."""
MAX_NORM_ERROR = 0.01
"""Largest error of the norm of a quaternion; tf2 has the same bound."""


class Role(StrEnum):
    """Use of a topic; the value is the usual name of the topic."""

    IMU = 'imu/data_raw'
    WHEELS = 'wheel/odometry'
    TEMPERATURE = 'imu/temperature'
    FEATURES = 'ceiling_camera/features'
    IMAGE = 'ceiling_camera/image_raw'
    CAMERA_INFO = 'ceiling_camera/camera_info'
    TRUTH = 'ground_truth/odometry'
    HEADING = 'heading_reference'


TYPES: dict[Role, tuple[str, ...]] = {
    Role.IMU: (IMU,),
    Role.WHEELS: (ODOMETRY,),
    Role.TEMPERATURE: (TEMPERATURE,),
    Role.FEATURES: (POINT_CLOUD,),
    Role.IMAGE: (IMAGE, COMPRESSED_IMAGE),
    Role.CAMERA_INFO: (CAMERA_INFO,),
    Role.TRUTH: tuple(POSES),
}
"""Message types that each role accepts; those of a heading reference are in `headings`."""

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class FieldConversion(Generic[T]):
    """Converts a message to a value by reading a few of its numeric fields."""

    fields: tuple[str, ...]
    """Dotted names of the fields, in the order of the message definition."""
    build: Callable[..., T]
    """Function from the numbers in these fields to the value."""

    def value(self, message: Any) -> T:
        """Convert one message."""
        return self.build(*attrgetter(*self.fields)(message))


STAMP_FIELDS = ('header.stamp.sec', 'header.stamp.nanosec')
"""Dotted names of the time stamp of a message with a header."""


def _members(parent: str, names: str) -> tuple[str, ...]:
    """Return the dotted names of members that have names of one letter."""
    return tuple(f'{parent}.{name}' for name in names)


def imu_sample(
    sec: int, nanosec: int, wx: float, wy: float, wz: float, ax: float, ay: float, az: float
) -> ImuSample:
    """Return the sample of an Imu, given its numbers in the order of the message definition."""
    return ImuSample(sec * NS_PER_S + nanosec, (wx, wy, wz), measured_force((ax, ay, az)))


def measured_force(force_m_s2: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a specific force; zero where an IMU without an accelerometer has NaN, as others have zero."""
    is_absent = force_m_s2[0] != force_m_s2[0] and all(map(math.isnan, force_m_s2))
    return (0.0, 0.0, 0.0) if is_absent else force_m_s2


IMU_SAMPLE = FieldConversion(
    (*STAMP_FIELDS, *_members('angular_velocity', 'xyz'), *_members('linear_acceleration', 'xyz')), imu_sample
)
WHEEL_SAMPLE = FieldConversion(
    (*STAMP_FIELDS, 'twist.twist.linear.x', 'twist.twist.angular.z'),
    lambda sec, nanosec, speed, yaw_rate: WheelSample(sec * NS_PER_S + nanosec, speed, yaw_rate),
)
TEMPERATURE_SAMPLE = FieldConversion(
    (*STAMP_FIELDS, 'temperature'),
    lambda sec, nanosec, temperature: TemperatureSample(sec * NS_PER_S + nanosec, temperature),
)


def truth_sample(type_name: str) -> FieldConversion[TruthSample]:
    """Return the conversion of pose messages of a type, one of `POSES`."""

    def build(
        sec: int, nanosec: int, px: float, py: float, pz: float, x: float, y: float, z: float, w: float
    ) -> TruthSample:
        return TruthSample(sec * NS_PER_S + nanosec, (px, py, pz), yaw_from_quaternion(x, y, z, w))

    pose = POSES[type_name]
    position, orientation = _members(f'{pose}.position', 'xyz'), _members(f'{pose}.orientation', 'xyzw')
    return FieldConversion((*STAMP_FIELDS, *position, *orientation), build)


def field_conversion(role: Role, type_name: str) -> FieldConversion[Any]:
    """Return the conversion of the messages of a role that is read field by field.

    Raises:
        ValueError: messages of this role are decoded as a whole.
    """
    match role:
        case Role.IMU:
            return IMU_SAMPLE
        case Role.WHEELS:
            return WHEEL_SAMPLE
        case Role.TEMPERATURE:
            return TEMPERATURE_SAMPLE
        case Role.TRUTH:
            return truth_sample(type_name)
    raise ValueError(f'{role} is not read field by field')


def bounds(role: Role) -> Iterable[float]:
    """Return the bounds of the numbers of a role, in the order of its fields after the stamp."""
    match role:
        case Role.IMU:
            return IMU_BOUNDS
        case Role.WHEELS:
            return WHEEL_BOUNDS
        case Role.TRUTH | Role.HEADING:
            return repeat(MAX_DISTANCE_M)
    return repeat(MAX_READING)


def stamp_ns(message: Any) -> int:
    """Return the time of measurement of a message with a header."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def camera_intrinsics(message: Any) -> CameraIntrinsics:
    """Convert a CameraInfo to the intrinsics of its images: region of interest and binning are applied.

    Raises:
        MessageError: the message holds no calibration, one with impossible numbers, or a lens model other
            than those of `model.lens`.
    """
    k = [float(value) for value in (message.k if hasattr(message, 'k') else message.K)]
    d = [float(value) for value in (message.d if hasattr(message, 'd') else message.D)]
    if not all(abs(value) < MAX_INTRINSIC for value in (*k, *d)):
        raise MessageError('camera_info has impossible numbers', todo='calibrate the camera')
    if k[0] <= 0.0 or k[4] <= 0.0:
        raise MessageError('the camera is not calibrated (focal length 0)', todo='calibrate the camera')
    side, reach = max(message.width, message.height), FOCAL_LENGTHS
    if side and not all(reach[0] * side < focal_px < reach[1] * side for focal_px in (k[0], k[4])):
        what = f'a focal length of {k[0]:g} and {k[4]:g} px does not belong to images of {side} px'
        raise MessageError(what, todo='calibrate the camera at the resolution in use')
    lens = message.distortion_model
    if not lens or (lens not in COEFFICIENT_COUNTS and not any(d)):
        lens = 'plumb_bob'
    if lens not in COEFFICIENT_COUNTS or any(d[COEFFICIENT_COUNTS[lens] :]) or _lacks_coefficients(lens, d):
        raise MessageError(
            f'the lens model is {lens!r} with {len(d)} coefficients',
            todo=f'calibrate the camera with {", ".join(COEFFICIENT_COUNTS)}',
        )
    count = COEFFICIENT_COUNTS[lens]
    distortion = (*d, *[0.0] * count)[:count]
    roi = message.roi
    width_px, fx_px, cx_px = _as_read_out(
        message.width, roi.x_offset, roi.width, message.binning_x, k[0], k[2]
    )
    height_px, fy_px, cy_px = _as_read_out(
        message.height, roi.y_offset, roi.height, message.binning_y, k[4], k[5]
    )
    return CameraIntrinsics(width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, lens)


def _as_read_out(
    size: int, offset: int, part: int, binning: int, f_px: float, c_px: float
) -> tuple[int, float, float]:
    """Return size, focal length and principal point along one axis of the image as it is read out.

    Size and calibration in a CameraInfo are those of the whole sensor; zeros stand for all of it, and for no
    binning.

    Raises:
        MessageError: the region is not inside the image.
    """
    part, binning = part or size - offset, binning or 1
    if size and not 0 < part <= size - offset or binning > max(part, 1):
        what = f'camera_info has an impossible region of interest or binning ({offset}, {part}, {binning})'
        raise MessageError(what, todo='check the driver of the camera')
    return part // binning, f_px / binning, (c_px - offset + 0.5) / binning - 0.5


def _lacks_coefficients(lens: str, d: Sequence[float]) -> bool:
    """Return True if coefficients are missing, other than k3 of `plumb_bob` or all of them."""
    return any(d) and len(d) < COEFFICIENT_COUNTS[lens] - (lens == 'plumb_bob')


def transforms(message: Any) -> list[Transform]:
    """Convert a TFMessage; leading slashes of old frame names are dropped.

    Raises:
        MessageError: a transform has impossible numbers.
    """
    links = []
    for item in message.transforms:
        p, q = item.transform.translation, item.transform.rotation
        mount = _mount(p, q, f'the transform from {item.header.frame_id!r} to {item.child_frame_id!r}')
        links.append(Transform(item.header.frame_id.lstrip('/'), item.child_frame_id.lstrip('/'), mount))
    return links


def body_pose(message: Any) -> Mount:
    """Return the pose of the body in an Odometry.

    Raises:
        MessageError: it has impossible numbers.
    """
    return _mount(message.pose.pose.position, message.pose.pose.orientation, 'the pose')


def _mount(p: Any, q: Any, what: str) -> Mount:
    """Return position and rotation.

    Raises:
        MessageError: a number is not finite or far too large, or the quaternion is not normalised.
    """
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if not (all(abs(value) < MAX_DISTANCE_M for value in (p.x, p.y, p.z)) and abs(norm - 1) < MAX_NORM_ERROR):
        problem = f'{what} has impossible numbers (NaN, or a quaternion that is not normalised)'
        raise MessageError(problem, todo='check its publisher')
    rotation = rotation_from_quaternion(q.x / norm, q.y / norm, q.z / norm, q.w / norm)
    return Mount(rotation, np.array([p.x, p.y, p.z]))


def map_frame(odom_frame: str) -> str:
    """Return the map frame that belongs to an odom frame: `robot1/map` for `robot1/odom`."""
    prefix, slash, _ = odom_frame.rpartition('/')
    return f'{prefix}{slash}{MAP_FRAME}'


def numeric_fields(message: Any) -> Iterator[str]:
    """Yield the dotted names of all scalar numbers in a message, except its header."""
    if is_dataclass(message):
        # constants of the message definition are the fields that have a default
        names = [item.name for item in fields(message) if item.default is MISSING]
    else:
        names = list(message.get_fields_and_field_types())
    for name in names:
        value = getattr(message, name)
        if isinstance(value, bool | int | float):
            yield name
        elif name != 'header' and (is_dataclass(value) or hasattr(value, 'get_fields_and_field_types')):
            yield from (f'{name}.{inner}' for inner in numeric_fields(value))


def covariate_name(topic: str, field: str) -> str:
    """Return the name of a recorded number, for example `battery_state.current`.

    Args:
        topic: the topic without its namespace.
        field: dotted name of the field.
    """
    return f'{topic.strip("/").replace("/", ".")}.{field}'
