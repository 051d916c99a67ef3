"""How the robot moves between two moments, and how that depends on where it was and on its rates.

The paper steps from sample to sample; here one block of samples between two camera frames is
integrated at once, with all derivatives, so that the covariance is touched once a frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array

PICARD_ITERATIONS = 4
"""Enough for blocks in which the robot turns up to some 20 deg: the error left in roll and pitch
is (turn)^4 / 24 of the tilt."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Pose at the end of a block and its derivatives; a pose is (position, Euler angles), 6 values."""

    position_m: Array
    """(3,)"""
    euler_rad: Array
    """(3,) roll, pitch, yaw, not wrapped."""
    transition: Array
    """(6, 6) d pose / d pose at the start."""
    rate_gain: Array
    """(6, 3, N) d pose / d body rate of each interval."""
    step_gain: Array
    """(3, 3, N) d position / d step in body axes of each interval: the attitudes on the way."""
    mid_euler_rad: Array
    """(3, N) attitude in the middle of each interval."""


def integrate(
    position_m: Array, euler_rad: Array, rate_rad_s: Array, dt_s: Array, distance_m: Array
) -> Motion:
    """Eq. (2): carry the pose over a block of N intervals, Eq. (1) being its continuous form.

    The Euler angles are integrated by the midpoint rule, solved for all intervals at once by
    Picard iteration: on a floor roll and pitch are small and the yaw hardly depends on them.

    Args:
        position_m: (3,) at the start.
        euler_rad: (3,) at the start.
        rate_rad_s: (N, 3) true body rates, mean over each interval.
        dt_s: (N,)
        distance_m: (N,) wheel-odometry step along body x.

    Returns:
        The pose at the end and its derivatives, to first order in what happens inside the block.
    """
    rate = rate_rad_s.T
    mid = euler_rad[:, None] + np.zeros_like(rate)
    for _ in range(PICARD_ITERATIONS):
        increments = _euler_rates(mid, rate) * dt_s
        ends = np.cumsum(increments, axis=1)
        mid = euler_rad[:, None] + ends - 0.5 * increments
    rotation = _rotations(mid)
    step = rotation[:, 0] * distance_m

    drift = _rate_derivatives(mid, rate) * dt_s
    drift_before = np.cumsum(drift, axis=2) - 0.5 * drift
    drift_total = drift.sum(axis=2)
    squared = drift_total @ drift_total
    turn = np.eye(3) + drift_total + squared / 2.0 + squared @ drift_total / 6.0

    step_by_euler = _forward_derivatives(mid) * distance_m
    moved_by_start = np.einsum('ijn,jkn->ik', step_by_euler, drift_before) + step_by_euler.sum(axis=2)
    transition = np.eye(6)
    transition[3:, 3:] = turn
    transition[:3, 3:] = moved_by_start

    euler_gain = _euler_rate_matrices(mid) * dt_s
    rate_gain = np.empty((6, 3, len(dt_s)))
    drift_after = drift_total[:, :, None] - drift_before
    rate_gain[3:] = euler_gain + np.einsum('ijn,jkn->ikn', drift_after, euler_gain)
    steps_after = np.cumsum(step_by_euler[:, :, ::-1], axis=2)[:, :, ::-1] - 0.5 * step_by_euler
    rate_gain[:3] = np.einsum('ijn,jkn->ikn', steps_after, euler_gain)
    return Motion(
        position_m=position_m + step.sum(axis=1),
        euler_rad=euler_rad + ends[:, -1],
        transition=transition,
        rate_gain=rate_gain,
        step_gain=rotation,
        mid_euler_rad=mid,
    )


def _euler_rates(euler: Array, rate: Array) -> Array:
    """Rates (3, N) of the Euler angles, `E_wb` of eq. (4) times the body rates."""
    sr, cr, tp = np.sin(euler[0]), np.cos(euler[0]), np.tan(euler[1])
    level = sr * rate[1] + cr * rate[2]
    return np.stack([rate[0] + tp * level, cr * rate[1] - sr * rate[2], level / np.cos(euler[1])])


def _euler_rate_matrices(euler: Array) -> Array:
    """`E_wb` of eq. (4) for N attitudes, (3, 3, N)."""
    sr, cr = np.sin(euler[0]), np.cos(euler[0])
    tp, secant = np.tan(euler[1]), 1.0 / np.cos(euler[1])
    matrices = np.zeros((3, *euler.shape))
    matrices[0, 0] = 1.0
    matrices[0, 1], matrices[0, 2] = sr * tp, cr * tp
    matrices[1, 1], matrices[1, 2] = cr, -sr
    matrices[2, 1], matrices[2, 2] = sr * secant, cr * secant
    return matrices


def _rate_derivatives(euler: Array, rate: Array) -> Array:
    """Derivative (3, 3, N) of the Euler rates with respect to the Euler angles."""
    sr, cr = np.sin(euler[0]), np.cos(euler[0])
    tp, secant = np.tan(euler[1]), 1.0 / np.cos(euler[1])
    level = sr * rate[1] + cr * rate[2]
    across = cr * rate[1] - sr * rate[2]
    derivatives = np.zeros((3, *euler.shape))
    derivatives[0, 0], derivatives[0, 1] = tp * across, level * secant**2
    derivatives[1, 0] = -level
    derivatives[2, 0], derivatives[2, 1] = across * secant, level * tp * secant
    return derivatives


def _rotations(euler: Array) -> Array:
    """`C_wb` of eq. (3) for N attitudes, (3, 3, N)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(euler), np.cos(euler)
    return np.stack(
        [
            np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]),
            np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]),
            np.stack([-sp, cp * sr, cp * cr]),
        ]
    )


def _forward_derivatives(euler: Array) -> Array:
    """Derivative (3, 3, N) of the body x axis in the world with respect to the Euler angles."""
    (_, sp, sy), (_, cp, cy) = np.sin(euler), np.cos(euler)
    derivatives = np.zeros((3, *euler.shape))
    derivatives[0, 1], derivatives[0, 2] = -cy * sp, -sy * cp
    derivatives[1, 1], derivatives[1, 2] = -sy * sp, cy * cp
    derivatives[2, 1] = -cp
    return derivatives
