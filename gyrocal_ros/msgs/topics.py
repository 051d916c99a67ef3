"""The topics of a robot, and the conversion of their messages to the values of `data`.

With `messages`, which goes the other way, the one place that knows what ROS messages look like.
Messages of rosbags and of rclpy have the same attributes, so both serve bags and live nodes alike,
and neither needs ROS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import StrEnum
from functools import lru_cache
from operator import attrgetter
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CameraIntrinsics,
    FeatureObservations,
    HeadingSample,
    ImuSample,
    Mount,
    SearchRegions,
    TemperatureSample,
    TruthSample,
    WheelSample,
)
from gyrocal_ros.errors import RecordingError
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
"""Messages that hold a pose, and where in them it lies."""


class Role(StrEnum):
    """What a topic is used for; its value is the topic's usual name."""

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
    Role.HEADING: tuple(POSES),
}

T = TypeVar('T')


@dataclass(frozen=True, slots=True)
class FlatMessage(Generic[T]):
    """A message of which only a few numbers count."""

    fields: tuple[str, ...]
    """Dotted names of the numbers, in the order of the message definition."""
    build: Callable[..., T]
    """Makes the value from those numbers."""

    def value(self, message: Any) -> T:
        """Convert one message."""
        return self.build(*attrgetter(*self.fields)(message))


STAMP_FIELDS = ('header.stamp.sec', 'header.stamp.nanosec')


def _under(place: str, names: str) -> tuple[str, ...]:
    return tuple(f'{place}.{name}' for name in names)


def imu_sample(
    sec: int, nanosec: int, wx: float, wy: float, wz: float, ax: float, ay: float, az: float
) -> ImuSample:
    """An Imu from its numbers, in the order of the message definition."""
    return ImuSample(sec * NS_PER_S + nanosec, (wx, wy, wz), (ax, ay, az))


IMU_SAMPLE = FlatMessage(
    (*STAMP_FIELDS, *_under('angular_velocity', 'xyz'), *_under('linear_acceleration', 'xyz')), imu_sample
)
WHEEL_SAMPLE = FlatMessage(
    (*STAMP_FIELDS, 'twist.twist.linear.x', 'twist.twist.angular.z'),
    lambda sec, nanosec, speed, yaw_rate: WheelSample(sec * NS_PER_S + nanosec, speed, yaw_rate),
)
TEMPERATURE_SAMPLE = FlatMessage(
    (*STAMP_FIELDS, 'temperature'),
    lambda sec, nanosec, temperature: TemperatureSample(sec * NS_PER_S + nanosec, temperature),
)


def truth_sample(type_name: str) -> FlatMessage[TruthSample]:
    """Conversion of the pose messages of that type, one of `POSES`."""

    def build(
        sec: int, nanosec: int, px: float, py: float, pz: float, x: float, y: float, z: float, w: float
    ) -> TruthSample:
        return TruthSample(sec * NS_PER_S + nanosec, (px, py, pz), yaw_from_quaternion(x, y, z, w))

    pose = POSES[type_name]
    place, turn = _under(f'{pose}.position', 'xyz'), _under(f'{pose}.orientation', 'xyzw')
    return FlatMessage((*STAMP_FIELDS, *place, *turn), build)


def heading_sample(type_name: str) -> FlatMessage[HeadingSample]:
    """Conversion of the pose messages of that type, one of `POSES`, to their heading alone."""

    def build(sec: int, nanosec: int, x: float, y: float, z: float, w: float) -> HeadingSample:
        return HeadingSample(sec * NS_PER_S + nanosec, yaw_from_quaternion(x, y, z, w))

    turn = _under(f'{POSES[type_name]}.orientation', 'xyzw')
    return FlatMessage((*STAMP_FIELDS, *turn), build)


def flat_message(role: Role, type_name: str) -> FlatMessage[Any]:
    """Conversion of the messages of a role in which only a few numbers count."""
    match role:
        case Role.IMU:
            return IMU_SAMPLE
        case Role.WHEELS:
            return WHEEL_SAMPLE
        case Role.TEMPERATURE:
            return TEMPERATURE_SAMPLE
        case Role.TRUTH:
            return truth_sample(type_name)
        case Role.HEADING:
            return heading_sample(type_name)
    raise ValueError(f'{role} is not read number by number')


def stamp_ns(message: Any) -> int:
    """Time of measurement of a message with a header."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def features(message: Any) -> FeatureObservations:
    """Convert a PointCloud2 of tracked features; points that are no numbers are left out.

    Raises:
        RecordingError: it lacks one of the fields u, v, id.
    """
    points = _points(message, ('u', 'v', 'id'))
    ids, pixels = points['id'].astype(np.int64), _pairs(points, 'u', 'v')
    finite = np.isfinite(pixels).all(axis=1)
    if not finite.all():
        ids, pixels = ids[finite], pixels[finite]
    return FeatureObservations(stamp_ns(message), ids, pixels)


def search_regions(message: Any) -> SearchRegions:
    """Convert a PointCloud2 of search regions.

    Raises:
        RecordingError: it lacks one of its fields.
    """
    points = _points(message, ('u', 'v', 'id', 'cov_uu', 'cov_uv', 'cov_vv'))
    rows = _pairs(points, 'cov_uu', 'cov_uv'), _pairs(points, 'cov_uv', 'cov_vv')
    return SearchRegions(
        stamp_ns(message), points['id'].astype(np.int64), _pairs(points, 'u', 'v'), np.stack(rows, axis=1)
    )


def _pairs(points: NDArray[Any], first: str, second: str) -> Array:
    pairs = np.empty((len(points), 2))
    pairs[:, 0], pairs[:, 1] = points[first], points[second]
    return pairs


def _points(message: Any, names: tuple[str, ...]) -> NDArray[Any]:
    layout = tuple((item.name, item.offset, item.datatype) for item in message.fields)
    kind = _point_type(layout, message.point_step, message.is_bigendian)
    missing = [name for name in names if name not in (kind.names or ())]
    if missing:
        raise RecordingError(
            f'a point cloud lacks the field {missing[0]}', todo=f'its points need {", ".join(names)}'
        )
    return np.frombuffer(message.data, kind, count=message.width * message.height)


@lru_cache
def _point_type(layout: tuple[tuple[str, int, int], ...], size: int, big_endian: bool) -> np.dtype[Any]:
    codes = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
    names, offsets, kinds = zip(*layout, strict=True) if layout else ((), (), ())
    order = '>' if big_endian else '<'
    return np.dtype(
        {
            'names': list(names),
            'formats': [order + codes[kind] for kind in kinds],
            'offsets': list(offsets),
            'itemsize': size,
        }
    )


def camera_intrinsics(message: Any) -> CameraIntrinsics:
    """Convert a CameraInfo.

    Raises:
        RecordingError: it holds no calibration, or a lens model other than plumb_bob.
    """
    k = [float(value) for value in (message.k if hasattr(message, 'k') else message.K)]
    d = [float(value) for value in (message.d if hasattr(message, 'd') else message.D)]
    if k[0] <= 0.0 or k[4] <= 0.0:
        raise RecordingError('the camera is not calibrated (focal length 0)', todo='calibrate the camera')
    if any(d) and (len(d) > 5 or message.distortion_model not in ('plumb_bob', '')):
        raise RecordingError(
            f'the lens model is {message.distortion_model!r}', todo='calibrate the camera with plumb_bob'
        )
    k1, k2, p1, p2, k3 = [*d, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return CameraIntrinsics(
        message.width, message.height, k[0], k[4], k[2], k[5], distortion=(k1, k2, p1, p2, k3)
    )


def transforms(message: Any) -> list[Transform]:
    """Convert a TFMessage; leading slashes of old frame names are dropped."""
    links = []
    for item in message.transforms:
        p, q = item.transform.translation, item.transform.rotation
        mount = Mount(rotation_from_quaternion(q.x, q.y, q.z, q.w), np.array([p.x, p.y, p.z]))
        links.append(Transform(item.header.frame_id.lstrip('/'), item.child_frame_id.lstrip('/'), mount))
    return links


def body_pose(message: Any) -> Mount:
    """Where an Odometry says the body is."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return Mount(rotation_from_quaternion(q.x, q.y, q.z, q.w), np.array([p.x, p.y, p.z]))


def map_frame(odom_frame: str) -> str:
    """The map of the robot that has this odom: `robot1/map` for `robot1/odom`."""
    prefix, slash, _ = odom_frame.rpartition('/')
    return f'{prefix}{slash}{MAP_FRAME}'


def numeric_fields(message: Any) -> Iterator[str]:
    """Yield the dotted names of all single numbers in a message, its header left out."""
    if is_dataclass(message):
        names = [item.name for item in fields(message) if item.default is MISSING]  # constants have one
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
