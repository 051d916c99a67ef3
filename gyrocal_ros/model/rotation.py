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
