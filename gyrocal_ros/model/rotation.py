"""Attitude as z-y-x Euler angles: the paper's rotation matrices and their derivatives."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array


def rotation_from_euler(euler: Array) -> Array:
    """Eq. (3): direction cosine matrix `C_wb` of roll, pitch, yaw.

    Args:
        euler: (3,) rad.

    Returns:
        (3, 3), turns body coordinates into world coordinates.
    """
    cr, sr = math.cos(euler[0]), math.sin(euler[0])
    cp, sp = math.cos(euler[1]), math.sin(euler[1])
    cy, sy = math.cos(euler[2]), math.sin(euler[2])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_derivatives(euler: Array) -> Array:
    """Derivatives of `rotation_from_euler` with respect to roll, pitch and yaw.

    Returns:
        (3, 3, 3): the first axis counts the angle.
    """
    cr, sr = math.cos(euler[0]), math.sin(euler[0])
    cp, sp = math.cos(euler[1]), math.sin(euler[1])
    cy, sy = math.cos(euler[2]), math.sin(euler[2])
    return np.array(
        [
            [
                [0.0, cy * sp * cr + sy * sr, -cy * sp * sr + sy * cr],
                [0.0, sy * sp * cr - cy * sr, -sy * sp * sr - cy * cr],
                [0.0, cp * cr, -cp * sr],
            ],
            [
                [-cy * sp, cy * cp * sr, cy * cp * cr],
                [-sy * sp, sy * cp * sr, sy * cp * cr],
                [-cp, -sp * sr, -sp * cr],
            ],
            [
                [-sy * cp, -sy * sp * sr - cy * cr, -sy * sp * cr + cy * sr],
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [0.0, 0.0, 0.0],
            ],
        ]
    )


def euler_rate_matrix(euler: Array) -> Array:
    """Eq. (4): `E_wb`, from body rates to the rates of roll, pitch and yaw.

    Returns:
        (3, 3); singular at a pitch of 90 deg, which a robot on a floor does not reach.
    """
    cr, sr = math.cos(euler[0]), math.sin(euler[0])
    cp, tp = math.cos(euler[1]), math.tan(euler[1])
    return np.array([[1.0, sr * tp, cr * tp], [0.0, cr, -sr], [0.0, sr / cp, cr / cp]])


def euler_from_rotation(R_wb: Array) -> Array:
    """Roll, pitch and yaw (3,) of a rotation matrix: the inverse of `rotation_from_euler`."""
    return np.array(
        [
            math.atan2(R_wb[2, 1], R_wb[2, 2]),
            -math.asin(max(-1.0, min(1.0, float(R_wb[2, 0])))),
            math.atan2(R_wb[1, 0], R_wb[0, 0]),
        ]
    )


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> Array:
    """Rotation matrix (3, 3) of a quaternion in ROS order; it need not be normalised."""
    n = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / n, y / n, z / n, w / n
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R_ab: Array) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a rotation matrix, by its largest component."""
    trace = float(np.trace(R_ab))
    squares = [trace, *(2.0 * float(R_ab[i, i]) - trace for i in range(3))]
    largest = int(np.argmax(squares))
    s = 2.0 * math.sqrt(1.0 + squares[largest])
    if largest == 0:
        w = 0.25 * s
        x, y, z = R_ab[2, 1] - R_ab[1, 2], R_ab[0, 2] - R_ab[2, 0], R_ab[1, 0] - R_ab[0, 1]
        return float(x / s), float(y / s), float(z / s), w
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    vector = [0.0, 0.0, 0.0]
    vector[i] = 0.25 * s
    vector[j] = float(R_ab[j, i] + R_ab[i, j]) / s
    vector[k] = float(R_ab[k, i] + R_ab[i, k]) / s
    return vector[0], vector[1], vector[2], float(R_ab[k, j] - R_ab[j, k]) / s


def wrap_angle(angle_rad: float) -> float:
    """Bring an angle into [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
