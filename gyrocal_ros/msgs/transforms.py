"""Where the sensors sit: quaternions, chains of frames, and which way up an IMU is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, Mount

IDENTITY = Mount(np.eye(3), np.zeros(3))

UP_MIN_COS = math.cos(math.radians(40.0))
"""An axis points up when gravity lies closer to it than this."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """One link between two frames: `p_parent = R p_child + p`."""

    parent: str
    child: str
    mount: Mount


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Heading (rad) of a quaternion in ROS order; it need not be normalised."""
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_from_yaw(yaw_rad: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a turn about z."""
    return 0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)


def quaternion_from_euler(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of z-y-x Euler angles."""
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
    """Rotation matrix (3, 3) of a quaternion in ROS order; it need not be normalised, but not zero."""
    v = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: Array = (w * w - v @ v) * np.eye(3) + 2.0 * (np.outer(v, v) + w * cross)
    return rotation / (w * w + v @ v)


def quaternion_from_rotation(R_ab: Array) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a rotation matrix (3, 3)."""
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
    largest = int(np.argmax(squares))  # dividing by the largest keeps the others exact
    x, y, z, w = outer[largest] / math.sqrt(squares[largest])
    return float(x), float(y), float(z), float(w)


def between(of_body: Mount, in_other: Mount) -> Mount:
    """Where another frame sits, by where the body is in both: `of_body` here, `in_other` there."""
    R = of_body.R_bs @ in_other.R_bs.T
    return Mount(R, of_body.p_bs - R @ in_other.p_bs)


def find_mount(transforms: Sequence[Transform], sensor: str, body: str) -> Mount | None:
    """Follow the chain of frames between a sensor and the robot body.

    Args:
        transforms: the links, in any order; of two for one child the later counts.
        sensor: frame of the sensor.
        body: frame of the robot body.

    Returns:
        The sensor in body axes, or None where no chain leads from one to the other.
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
    """Return the frame itself and all above it, each with where `frame` sits in it."""
    found = {frame: IDENTITY}
    while (link := parents.get(frame)) and link.parent not in found:
        below, up = found[frame], link.mount
        frame = link.parent
        found[frame] = Mount(up.R_bs @ below.R_bs, up.R_bs @ below.p_bs + up.p_bs)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class RightAngle:
    """A rotation that an installer may have given an IMU."""

    R_bs: Array
    """(3, 3) from the IMU's axes to body axes."""
    words: str
    """What it does, for a person: `180 deg about x`."""


UPRIGHT = RightAngle(np.eye(3), 'none')
UPSIDE_DOWN = RightAngle(np.diag([1.0, -1.0, -1.0]), '180 deg about x')
_MENDING = {
    (0, 1): RightAngle(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), '-90 deg about y'),
    (0, -1): RightAngle(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), '90 deg about y'),
    (1, 1): RightAngle(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), '90 deg about x'),
    (1, -1): RightAngle(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), '-90 deg about x'),
    (2, 1): UPRIGHT,
    (2, -1): UPSIDE_DOWN,
}


def upright_rotation(specific_force_m_s2: Array) -> RightAngle | None:
    """Return the right-angle rotation that makes a resting accelerometer read +z.

    Gravity leaves the turn about the vertical open; the shortest rotation is taken.

    Args:
        specific_force_m_s2: (3,) mean reading in the IMU's own axes.

    Returns:
        `UPRIGHT` where nothing is to mend, None where no axis clearly points up.
    """
    size = float(np.linalg.norm(specific_force_m_s2))
    axis = int(np.argmax(np.abs(specific_force_m_s2)))
    component = float(specific_force_m_s2[axis])
    if not abs(component) > UP_MIN_COS * size > 0.0:
        return None
    return _MENDING[axis, 1 if component > 0.0 else -1]
