"""Attitude as z-y-x Euler angles: the paper's rotation matrices and their derivatives."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled


@compiled
def rotation_from_euler(euler: Array) -> Array:
    """Eq. (3): return the direction cosine matrix `C_wb` of roll, pitch, yaw.

    Args:
        euler: (3,) rad.

    Returns:
        (3, 3), maps body coordinates to world coordinates.
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


@compiled
def rotation_derivatives(euler: Array) -> Array:
    """Return the derivatives of `rotation_from_euler` with respect to roll, pitch and yaw.

    Returns:
        (3, 3, 3): the first axis is that of the angles.
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


def euler_rate_matrices(euler: Array) -> Array:
    """Eq. (4): return `E_wb`, which maps body rates to the rates of roll, pitch and yaw, for N attitudes.

    Args:
        euler: (3, N) rad.

    Returns:
        (3, 3, N); singular at a pitch of 90 deg, which a robot on a floor does not reach.
    """
    sr, cr, secant = np.sin(euler[0]), np.cos(euler[0]), 1.0 / np.cos(euler[1])
    matrices = np.zeros((3, *euler.shape))
    matrices[0, 0] = 1.0
    matrices[1, 1], matrices[1, 2] = cr, -sr
    matrices[2, 1], matrices[2, 2] = sr * secant, cr * secant
    matrices[0, 1:] = matrices[2, 1:] * np.sin(euler[1])
    return matrices
