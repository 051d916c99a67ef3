"""Quaternions, rotations, chains of frames, and the upright rotation of an IMU."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, Mount

IDENTITY = Mount(np.eye(3), np.zeros(3))

UP_MIN_COS = math.cos(math.radians(40.0))
"""Minimum cosine between an axis and the specific force at rest for the axis to count as vertical."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """Transform between two frames: `p_parent = R p_child + p`."""

    parent: str
    child: str
    mount: Mount


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the heading (rad) of a quaternion in ROS order, which need not be normalised."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_from_yaw(yaw_rad: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a rotation about z."""
    return 0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)


def quaternion_from_euler(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of z-y-x Euler angles."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion in ROS order.

    The quaternion need not be normalised but must not be zero.
    """
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Array = (w * w - v @ v) * np.eye(3) + 2.0 * (np.outer(v, v) + w * cross)
    return rotation / (w * w + v @ v)


def quaternion_from_rotation(R_ab: Array) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a rotation matrix (3, 3)."""
    xx, yy, zz = np.diag(R_ab)
    squares = np.array([1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz]) / 4.0
    products = np.array(
        [
            [0.0, R_ab[1, 0] + R_ab[0, 1], R_ab[2, 0] + R_ab[0, 2], R_ab[2, 1] - R_ab[1, 2]],
            [0.0, 0.0, R_ab[2, 1] + R_ab[1, 2], R_ab[0, 2] - R_ab[2, 0]],
            [0.0, 0.0, 0.0, R_ab[1, 0] - R_ab[0, 1]],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    outer = np.diag(squares) + (products + products.T) / 4.0
    largest = int(np.argmax(squares))  # dividing by the largest component is the most accurate
    x, y, z, w = outer[largest] / math.sqrt(squares[largest])
    return float(x), float(y), float(z), float(w)


def relative_pose(body_in_a: Mount, body_in_b: Mount) -> Mount:
    """Return the pose of frame b in frame a, given the pose of the body in both."""
    R_ab = body_in_a.R_bs @ body_in_b.R_bs.T
    return Mount(R_ab, body_in_a.p_bs - R_ab @ body_in_b.p_bs)


def find_mount(transforms: Sequence[Transform], sensor: str, body: str) -> Mount | None:
    """Follow the chain of frames between a sensor and the robot body.

    Args:
        transforms: the transforms in any order; the later of two with the same child is used.
        sensor: frame of the sensor.
        body: frame of the robot body.

    Returns:
        The mount of the sensor in body axes, or None if no chain connects the two frames.
    """
    parents = {link.child: link for link in transforms}
    sensor_in, body_in = _ancestors(parents, sensor), _ancestors(parents, body)
    for frame, of_sensor in sensor_in.items():
        if frame in body_in:
            of_body = body_in[frame]
            R_bf = of_body.R_bs.T
            return Mount(R_bf @ of_sensor.R_bs, R_bf @ (of_sensor.p_bs - of_body.p_bs))
    return None


def _ancestors(parents: Mapping[str, Transform], frame: str) -> dict[str, Mount]:
    """Return the frame and all its ancestors, each with the pose of `frame` in it."""
    found = {frame: IDENTITY}
    while (link := parents.get(frame)) and link.parent not in found:
        below, up = found[frame], link.mount
        frame = link.parent
        found[frame] = Mount(up.R_bs @ below.R_bs, up.R_bs @ below.p_bs + up.p_bs)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class RightAngle:
    """Rotation by a multiple of 90 deg with which an IMU may be installed."""

    R_bs: Array
    """(3, 3) from the IMU's axes to body axes."""
    description: str
    """Description of the rotation for a person: `180 deg about x`."""


UPRIGHT = RightAngle(np.eye(3), 'none')
UPSIDE_DOWN = RightAngle(np.diag([1.0, -1.0, -1.0]), '180 deg about x')
_UPRIGHT_ROTATIONS = {
    (0, 1): RightAngle(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), '-90 deg about y'),
    (0, -1): RightAngle(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), '90 deg about y'),
    (1, 1): RightAngle(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), '90 deg about x'),
    (1, -1): RightAngle(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), '-90 deg about x'),
    (2, 1): UPRIGHT,
    (2, -1): UPSIDE_DOWN,
}
"""Rotation that makes an axis of the IMU (0 to 2) with a sign of the specific force point up."""


def upright_rotation(specific_force_m_s2: Array) -> RightAngle | None:
    """Return the right-angle rotation that makes a resting accelerometer read +z.

    Gravity does not determine the rotation about the vertical; the shortest rotation is returned.

    Args:
        specific_force_m_s2: (3,) mean reading in the IMU's own axes.

    Returns:
        `UPRIGHT` if no rotation is needed, None if no axis clearly points up.
    """
    size = float(np.linalg.norm(specific_force_m_s2))
    axis = int(np.argmax(np.abs(specific_force_m_s2)))
    component = float(specific_force_m_s2[axis])
    if not abs(component) > UP_MIN_COS * size > 0.0:
        return None
    return _UPRIGHT_ROTATIONS[axis, 1 if component > 0.0 else -1]
