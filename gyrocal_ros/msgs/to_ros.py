"""Conversion of the values of `data` to ROS messages, for bags and for live nodes."""

from __future__ import annotations

import math
from array import array, typecodes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.robot_sections import MessagesConfig
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
from gyrocal_ros.msgs import clouds, topics
from gyrocal_ros.msgs.transforms import Transform, quaternion_from_rotation, quaternion_from_yaw

BATTERY_NUMBERS = ('voltage', 'temperature', 'current', 'charge', 'capacity', 'design_capacity', 'percentage')
"""Measured fields of a BatteryState."""
DEFAULTS = MessagesConfig()
"""Default frames and covariances."""
UINT32, FLOAT32 = 6, 7
"""Data types of a PointField."""


@dataclass(frozen=True, slots=True)
class MessageMaker:
    """Makes messages of rosbags or rclpy by the name of their type: `make(topics.IMU, header=...)`."""

    get_class: Callable[[str], Callable[..., Any]]
    """Function from a type name such as `sensor_msgs/msg/Imu` to its class."""
    sequence: Callable[[NDArray[Any]], Any] = lambda values: values
    """Converts an array (n,) to the type of an unbounded sequence field."""

    def __call__(self, type_name: str, **values: Any) -> Any:
        """Make a message; every field must be given."""
        return self.get_class(type_name)(**values)

    def time(self, t_ns: int) -> Any:
        """Make a Time."""
        sec, nanosec = divmod(t_ns, NS_PER_S)
        return self('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec)

    def header(self, t_ns: int, frame: str) -> Any:
        """Make a Header."""
        return self('std_msgs/msg/Header', stamp=self.time(t_ns), frame_id=frame)

    def vector(self, values: tuple[float, ...], kind: str = 'Vector3') -> Any:
        """Make a Vector3 or a Point."""
        x, y, z = values
        return self(f'geometry_msgs/msg/{kind}', x=x, y=y, z=z)

    def quaternion(self, values: tuple[float, float, float, float]) -> Any:
        """Make a Quaternion."""
        x, y, z, w = values
        return self('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w)

    def pose(self, position_m: tuple[float, float, float], yaw_rad: float) -> Any:
        """Make a Pose."""
        orientation = self.quaternion(quaternion_from_yaw(yaw_rad))
        position = self.vector(position_m, 'Point')
        return self('geometry_msgs/msg/Pose', position=position, orientation=orientation)


def diagonal(variances: Sequence[float]) -> Array:
    """Return the covariance (n * n,), in rows, of n independent values."""
    count = len(variances)
    covariance = np.zeros(count * count)
    covariance[:: count + 1] = variances
    return covariance


def live_maker(get_class: Callable[[str], Callable[..., Any]]) -> MessageMaker:
    """Return a maker of rclpy messages.

    Args:
        get_class: `rosidl_runtime_py.utilities.get_message`.
    """

    def sequence(values: NDArray[Any]) -> Any:
        code = values.dtype.char
        return array(code, values.tobytes()) if code in typecodes else values.tolist()

    return MessageMaker(cache(get_class), sequence)


def imu(make: MessageMaker, sample: ImuSample, config: MessagesConfig = DEFAULTS) -> Any:
    """Convert an IMU sample to an Imu without orientation."""
    rate_std = math.radians(config.rate_std_deg_s)
    return make(
        topics.IMU,
        header=make.header(sample.t_ns, config.imu_frame),
        orientation=make.quaternion((0.0, 0.0, 0.0, 1.0)),
        orientation_covariance=np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        angular_velocity=make.vector(sample.rate_rad_s),
        angular_velocity_covariance=diagonal((rate_std**2,) * 3),
        linear_acceleration=make.vector(sample.specific_force_m_s2),
        linear_acceleration_covariance=diagonal((config.acceleration_std_m_s2**2,) * 3),
    )


def set_imu(message: Any, sample: ImuSample) -> None:
    """Put a sample into an Imu made before, which takes a fraction of the time of a new one."""
    stamp, rate, force = message.header.stamp, message.angular_velocity, message.linear_acceleration
    stamp.sec, stamp.nanosec = divmod(sample.t_ns, NS_PER_S)
    rate.x, rate.y, rate.z = sample.rate_rad_s
    force.x, force.y, force.z = sample.specific_force_m_s2


def odometry(
    make: MessageMaker,
    t_ns: int,
    frame: str,
    position_m: tuple[float, float, float],
    yaw_rad: float,
    *,
    speed_m_s: float = 0.0,
    yaw_rate_rad_s: float = 0.0,
    body_frame: str = topics.BODY_FRAME,
    pose_stds: Sequence[float] = (0.0,) * 6,
    twist_stds: Sequence[float] = (0.0,) * 6,
) -> Any:
    """Make an Odometry of the robot body in `frame`.

    The standard deviations are those of x, y, z and of the rotations about them; zeros for unknown ones.
    """
    twist = make(
        'geometry_msgs/msg/Twist',
        linear=make.vector((speed_m_s, 0.0, 0.0)),
        angular=make.vector((0.0, 0.0, yaw_rate_rad_s)),
    )
    return make(
        topics.ODOMETRY,
        header=make.header(t_ns, frame),
        child_frame_id=body_frame,
        pose=make(
            'geometry_msgs/msg/PoseWithCovariance',
            pose=make.pose(position_m, yaw_rad),
            covariance=diagonal([std**2 for std in pose_stds]),
        ),
        twist=make(
            'geometry_msgs/msg/TwistWithCovariance',
            twist=twist,
            covariance=diagonal([std**2 for std in twist_stds]),
        ),
    )


def wheels(
    make: MessageMaker,
    sample: WheelSample,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    *,
    travelled_m: float = 0.0,
    turned_rad: float = 0.0,
    config: MessagesConfig = DEFAULTS,
) -> Any:
    """Convert a wheel sample to an Odometry whose pose the caller has integrated.

    Args:
        make: message maker.
        sample: the sample.
        x_m: pose by the wheels.
        y_m: pose by the wheels.
        yaw_rad: pose by the wheels.
        travelled_m: absolute distance since the start; the error of the pose grows with it.
        turned_rad: absolute turn since the start.
        config: frames and covariances.
    """
    unmeasured = config.unmeasured_std
    along = math.hypot(config.distance_error * travelled_m, unmeasured)
    about = math.hypot(config.turn_error * turned_rad, unmeasured)
    turn_rate_std = math.radians(config.turn_rate_std_deg_s)
    return odometry(
        make,
        sample.t_ns,
        config.odom_frame,
        (x_m, y_m, 0.0),
        yaw_rad,
        speed_m_s=sample.speed_m_s,
        yaw_rate_rad_s=sample.yaw_rate_rad_s,
        body_frame=config.base_frame,
        pose_stds=(along, along, *(unmeasured,) * 3, about),
        twist_stds=(config.speed_std_m_s, *(unmeasured,) * 4, turn_rate_std),
    )


def truth(make: MessageMaker, sample: TruthSample) -> Any:
    """Convert a ground truth sample to an Odometry in the frame `ground_truth`."""
    return odometry(make, sample.t_ns, 'ground_truth', sample.position_m, sample.yaw_rad)


def heading(make: MessageMaker, sample: HeadingSample) -> Any:
    """Convert a heading sample to a PoseStamped at the origin."""
    return make(
        topics.POSE_STAMPED,
        header=make.header(sample.t_ns, 'heading_reference'),
        pose=make.pose((0.0, 0.0, 0.0), sample.yaw_rad),
    )


def temperature(make: MessageMaker, sample: TemperatureSample, config: MessagesConfig = DEFAULTS) -> Any:
    """Convert a temperature sample to a Temperature."""
    return make(
        topics.TEMPERATURE,
        header=make.header(sample.t_ns, config.imu_frame),
        temperature=sample.temperature_c,
        variance=0.0,
    )


def battery(make: MessageMaker, t_ns: int, numbers: Mapping[str, float]) -> Any:
    """Make a BatteryState from some of its `BATTERY_NUMBERS`; the others are NaN (not measured)."""
    return make(
        topics.BATTERY,
        header=make.header(t_ns, ''),
        **{name: numbers.get(name, math.nan) for name in BATTERY_NUMBERS},
        power_supply_status=0,
        power_supply_health=0,
        power_supply_technology=0,
        present=True,
        cell_voltage=make.sequence(np.zeros(0, np.float32)),
        cell_temperature=make.sequence(np.zeros(0, np.float32)),
        location='',
        serial_number='',
    )


def number(make: MessageMaker, value: float) -> Any:
    """Make a Float64."""
    return make(topics.NUMBER, data=value)


def features(make: MessageMaker, observations: FeatureObservations, frame: str = topics.CAMERA_FRAME) -> Any:
    """Convert feature observations to a PointCloud2 in the camera frame.

    Its fields are u, v, id, and with covariances also cov_uu, cov_uv, cov_vv.
    """
    columns = {'u': observations.pixels[:, 0], 'v': observations.pixels[:, 1], 'id': observations.ids}
    if observations.covariances_px2 is not None:
        columns |= _covariance_columns(observations.covariances_px2)
    return _point_cloud(make, observations.t_ns, columns, frame)


def search_regions(make: MessageMaker, regions: SearchRegions) -> Any:
    """Convert search regions to a PointCloud2 with the fields u, v, id, cov_uu, cov_uv, cov_vv."""
    columns = {'u': regions.pixels[:, 0], 'v': regions.pixels[:, 1], 'id': regions.ids}
    return _point_cloud(make, regions.t_ns, columns | _covariance_columns(regions.covariances_px2))


def _covariance_columns(covariances: Array) -> dict[str, Array]:
    """Return the columns of covariances (n, 2, 2)."""
    upper = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    return dict(zip(clouds.COVARIANCES, upper, strict=True))


def _point_cloud(
    make: MessageMaker, t_ns: int, columns: Mapping[str, NDArray[Any]], frame: str = topics.CAMERA_FRAME
) -> Any:
    formats = {'id': '<u4'}
    points = np.zeros(len(columns['id']), np.dtype([(name, formats.get(name, '<f4')) for name in columns]))
    for name, values in columns.items():
        points[name] = values
    layout = [
        make(
            'sensor_msgs/msg/PointField',
            name=name,
            offset=4 * index,
            datatype=UINT32 if name == 'id' else FLOAT32,
            count=1,
        )
        for index, name in enumerate(columns)
    ]
    return make(
        topics.POINT_CLOUD,
        header=make.header(t_ns, frame),
        height=1,
        width=len(points),
        fields=layout,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=make.sequence(np.frombuffer(points.tobytes(), np.uint8)),
        is_dense=True,
    )


def camera_info(make: MessageMaker, camera: CameraIntrinsics, t_ns: int) -> Any:
    """Convert camera intrinsics to a CameraInfo."""
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    region = make(
        'sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    return make(
        topics.CAMERA_INFO,
        header=make.header(t_ns, topics.CAMERA_FRAME),
        height=camera.height_px,
        width=camera.width_px,
        distortion_model=camera.lens,
        d=make.sequence(np.array(camera.distortion)),
        k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.array([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def static_transforms(make: MessageMaker, mounts: Mapping[str, Mount], t_ns: int) -> Any:
    """Make a TFMessage of the mounts of the sensors.

    Args:
        make: message maker.
        mounts: mount of each sensor on the robot body, by the frame of the sensor.
        t_ns: time of the header.
    """
    return make(
        topics.TRANSFORMS,
        transforms=[
            _transform_stamped(
                make,
                t_ns,
                topics.BODY_FRAME,
                frame,
                tuple(mount.p_bs),
                quaternion_from_rotation(mount.R_bs),
            )
            for frame, mount in mounts.items()
        ],
    )


def transform(make: MessageMaker, t_ns: int, link: Transform) -> Any:
    """Make a TFMessage of one transform."""
    position, rotation = tuple(link.mount.p_bs), quaternion_from_rotation(link.mount.R_bs)
    stamped = _transform_stamped(make, t_ns, link.parent, link.child, position, rotation)
    return make(topics.TRANSFORMS, transforms=[stamped])


def odometry_transform(
    make: MessageMaker,
    t_ns: int,
    x_m: float,
    y_m: float,
    yaw_rad: float,
    config: MessagesConfig = DEFAULTS,
) -> Any:
    """Make a TFMessage with the pose of the robot body according to the wheel odometry."""
    position, rotation = (x_m, y_m, 0.0), quaternion_from_yaw(yaw_rad)
    stamped = _transform_stamped(make, t_ns, config.odom_frame, config.base_frame, position, rotation)
    return make(topics.TRANSFORMS, transforms=[stamped])


def _transform_stamped(
    make: MessageMaker,
    t_ns: int,
    parent: str,
    child: str,
    position_m: tuple[float, ...],
    rotation: tuple[float, float, float, float],
) -> Any:
    return make(
        'geometry_msgs/msg/TransformStamped',
        header=make.header(t_ns, parent),
        child_frame_id=child,
        transform=make(
            'geometry_msgs/msg/Transform',
            translation=make.vector(tuple(float(value) for value in position_m)),
            rotation=make.quaternion(rotation),
        ),
    )
