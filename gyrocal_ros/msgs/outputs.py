"""Conversion of the calibrator's outputs to ROS messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyrocal_ros.data import Array, CalibratedSample, IntArray, Mount, OdometryEstimate
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.to_ros import MessageMaker, diagonal
from gyrocal_ros.msgs.transforms import (
    Transform,
    quaternion_from_euler,
    quaternion_from_rotation,
    relative_pose,
)

SPHERE, ADD, DELETE = 2, 0, 2
"""Constants of visualization_msgs/Marker: type, and two values of `action`."""
MIN_DIAMETER_M, MAX_DIAMETER_M = 0.01, 10.0
"""Limits of the diameter of a marker: smaller ones are invisible, larger ones hide the others."""
ACCELERATION_STD_M_S2 = 0.05
"""Standard deviation of the acceleration, which the calibrator passes on as it came."""
GREEN = (0.2, 0.8, 0.3, 0.6)
"""Colour of the markers: red, green, blue and alpha."""

ParameterValue = bool | float | str | list[str] | list[float]
"""Type of the value of a parameter."""


def calibrated_imu(make: MessageMaker, sample: CalibratedSample, frame: str) -> Any:
    """Make an Imu with orientation and covariances."""
    return make(
        topics.IMU,
        header=make.header(sample.t_ns, frame),
        orientation=make.quaternion(quaternion_from_euler(*sample.euler_rad)),
        orientation_covariance=sample.euler_covariance.ravel(),
        angular_velocity=make.vector(sample.rate_rad_s),
        angular_velocity_covariance=diagonal(sample.rate_variances),
        linear_acceleration=make.vector(sample.specific_force_m_s2),
        linear_acceleration_covariance=diagonal((ACCELERATION_STD_M_S2**2,) * 3),
    )


def odometry_estimate(make: MessageMaker, estimate: OdometryEstimate, frame: str, body_frame: str) -> Any:
    """Make an Odometry with covariances."""
    pose = make(
        'geometry_msgs/msg/Pose',
        position=make.vector(estimate.position_m, 'Point'),
        orientation=make.quaternion(quaternion_from_euler(*estimate.euler_rad)),
    )
    twist = make(
        'geometry_msgs/msg/Twist',
        linear=make.vector((estimate.speed_m_s, 0.0, 0.0)),
        angular=make.vector(estimate.rate_rad_s),
    )
    return make(
        topics.ODOMETRY,
        header=make.header(estimate.t_ns, frame),
        child_frame_id=body_frame,
        pose=make(
            'geometry_msgs/msg/PoseWithCovariance', pose=pose, covariance=estimate.pose_covariance.ravel()
        ),
        twist=make(
            'geometry_msgs/msg/TwistWithCovariance',
            twist=twist,
            covariance=diagonal((*estimate.speed_variances, *estimate.rate_variances)),
        ),
    )


def map_to_odom(estimate: OdometryEstimate, body_in_odom: Mount, frame: str, odom_frame: str) -> Transform:
    """Return the transform from map to odom, given the pose of the body in both at one moment."""
    body_in_map = Mount(rotation_from_euler(np.array(estimate.euler_rad)), np.array(estimate.position_m))
    return Transform(frame, odom_frame, relative_pose(body_in_map, body_in_odom))


def ceiling_map(
    make: MessageMaker,
    t_ns: int,
    frame: str,
    ids: IntArray,
    points_m: Array,
    covariances_m2: Array,
    removed: Sequence[int],
) -> Any:
    """Make a MarkerArray of the features as ellipsoids whose half axes are one standard deviation.

    Args:
        make: message maker.
        t_ns: time of the map.
        frame: frame of the map.
        ids: (m,) ids of the features.
        points_m: (m, 3) positions of the features.
        covariances_m2: (m, 3, 3) covariances of the positions.
        removed: ids of the markers to delete.
    """
    variances, axes = np.linalg.eigh(covariances_m2)
    axes[np.linalg.det(axes) < 0.0] *= -1.0  # rotations, not mirrors
    sizes = np.clip(2.0 * np.sqrt(np.maximum(variances, 0.0)), MIN_DIAMETER_M, MAX_DIAMETER_M)
    markers = [
        _marker(make, t_ns, frame, feature, ADD, point, R, size)
        for feature, point, R, size in zip(ids.tolist(), points_m, axes, sizes, strict=True)
    ]
    unused = np.zeros(3), np.eye(3), np.ones(3)
    markers += [_marker(make, t_ns, frame, feature, DELETE, *unused) for feature in removed]
    return make('visualization_msgs/msg/MarkerArray', markers=markers)


def _marker(
    make: MessageMaker, t_ns: int, frame: str, feature: int, action: int, point: Array, R: Array, size: Array
) -> Any:
    red, green, blue, alpha = GREEN
    return make(
        'visualization_msgs/msg/Marker',
        header=make.header(t_ns, frame),
        ns='features',
        id=_marker_id(feature),
        type=SPHERE,
        action=action,
        pose=make(
            'geometry_msgs/msg/Pose',
            position=make.vector(tuple(point.tolist()), 'Point'),
            orientation=make.quaternion(quaternion_from_rotation(R)),
        ),
        scale=make.vector(tuple(size.tolist())),
        color=make('std_msgs/msg/ColorRGBA', r=red, g=green, b=blue, a=alpha),
        lifetime=make('builtin_interfaces/msg/Duration', sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource='',
        texture=make(
            topics.COMPRESSED_IMAGE,
            header=make.header(0, ''),
            format='',
            data=make.sequence(np.zeros(0, np.uint8)),
        ),
        uv_coordinates=[],
        text='',
        mesh_resource='',
        mesh_file=make(
            'visualization_msgs/msg/MeshFile', filename='', data=make.sequence(np.zeros(0, np.uint8))
        ),
        mesh_use_embedded_materials=False,
    )


def _marker_id(feature: int) -> int:
    """Return the id of a feature, an unsigned number of 32 bits, as the signed number of a Marker."""
    return (feature + 2**31) % 2**32 - 2**31


def parameter_event(
    make: MessageMaker, t_ns: int, node: str, parameters: Mapping[str, ParameterValue]
) -> Any:
    """Make a ParameterEvent that reports all the given parameters as changed."""
    sec, nanosec = divmod(t_ns, 10**9)
    changed = [
        make('rcl_interfaces/msg/Parameter', name=name, value=_parameter_value(make, value))
        for name, value in parameters.items()
    ]
    return make(
        'rcl_interfaces/msg/ParameterEvent',
        stamp=make('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec),
        node=node,
        new_parameters=[],
        changed_parameters=changed,
        deleted_parameters=[],
    )


def _parameter_value(make: MessageMaker, value: ParameterValue) -> Any:
    value_type, field = _parameter_type(value)
    content: Any = make.sequence(np.array(value, float)) if field == 'double_array_value' else value
    fields = {
        'bool_value': False,
        'integer_value': 0,
        'double_value': 0.0,
        'string_value': '',
        'byte_array_value': make.sequence(np.zeros(0, np.uint8)),
        'bool_array_value': make.sequence(np.zeros(0, bool)),
        'integer_array_value': make.sequence(np.zeros(0, np.int64)),
        'double_array_value': make.sequence(np.zeros(0)),
        'string_array_value': [],
    }
    return make('rcl_interfaces/msg/ParameterValue', type=value_type, **(fields | {field: content}))


def _parameter_type(value: ParameterValue) -> tuple[int, str]:
    """Return the type number of a ParameterValue and the name of the field that holds it."""
    match value:
        case bool():
            return 1, 'bool_value'
        case float():
            return 3, 'double_value'
        case str():
            return 4, 'string_value'
        case [str(), *_]:
            return 9, 'string_array_value'
    return 8, 'double_array_value'
