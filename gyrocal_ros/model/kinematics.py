"""Motion of the robot over one block of samples, with its derivatives by the pose before and by the rates.

The paper steps from sample to sample. Here one block of samples between two camera frames is integrated at
once, with all derivatives, so that the covariance is updated once per frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gyrocal_ros.data import Array, quickly_filled
from gyrocal_ros.model.rotation import euler_rate_matrices


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class PoseStep:
    """Pose at the end of a block and its derivatives; a pose is (position, Euler angles), 6 values."""

    position_m: Array
    """(3,)"""
    euler_rad: Array
    """(3,) roll, pitch, yaw, not wrapped."""
    transition: Array
    """(6, 6) d pose / d pose at the start."""
    rate_gain: Array
    """(6, 3, N) d pose / d body rate of each interval."""
    forward: Array
    """(3, N) body x axis in the world in the middle of each interval."""
    mid_euler_rad: Array
    """(3, N) attitude in the middle of each interval."""
    pose_rate: Array
    """(6,) rate of the pose at the end of the block."""


class _Trig(NamedTuple):
    """Sines and cosines of N roll, pitch and yaw angles."""

    sr: Array
    sp: Array
    sy: Array
    cr: Array
    cp: Array
    cy: Array


def integrate(
    position_m: Array, euler_rad: Array, rate_rad_s: Array, dt_s: Array, distance_m: Array
) -> PoseStep:
    """Eq. (2): carry the pose over a block of N intervals; Eq. (1) is its continuous form.

    The Euler angles follow the midpoint rule, for all intervals at once: `E_wb` of eq. (4) is evaluated at a
    first guess of the angles, which is exact to first order in roll and pitch. The remaining error is of
    third order in the tilt. `planar` has faster variants.

    Args:
        position_m: (3,) at the start.
        euler_rad: (3,) at the start.
        rate_rad_s: (N, 3) true body rates, mean over each interval.
        dt_s: (N,)
        distance_m: (N,) wheel-odometry step along body x.

    Returns:
        The pose at the end and its derivatives, to first order in the motion inside the block.
    """
    turns = rate_rad_s.T * dt_s
    guess = _nearly_level(euler_rad, turns)
    increments = _euler_increments(guess, turns)
    ends = increments.cumsum(axis=1)
    mid = euler_rad[:, None] + ends - 0.5 * increments
    trig = _Trig(*np.sin(mid), *np.cos(mid))

    # Derivatives of the steps (rows 0 to 2) and of the Euler increments (rows 3 to 5) by the Euler angles.
    by_euler = np.empty((6, 3, len(dt_s)))
    by_euler[:3] = _forward_derivatives(trig) * distance_m
    by_euler[3:] = _increment_derivatives(trig, turns)
    before = by_euler.cumsum(axis=2) - 0.5 * by_euler
    total = by_euler.sum(axis=2)
    drift = total[3:]
    squared = drift @ drift
    transition = np.eye(6)
    transition[3:, 3:] += drift + squared / 2.0 + squared @ drift / 6.0
    transition[:3, 3:] = np.einsum('ijn,jkn->ik', by_euler[:3], before[3:]) + total[:3]

    after = total[:, :, None] - before
    after[3:] += np.eye(3)[:, :, None]
    rate_gain = np.einsum('ijn,jkn->ikn', after, euler_rate_matrices(mid) * dt_s)
    forward = _forward(trig)
    last_step = np.concatenate([forward[:, -1] * distance_m[-1], increments[:, -1]])
    return PoseStep(
        position_m + forward @ distance_m,
        euler_rad + ends[:, -1],
        transition,
        rate_gain,
        forward,
        mid,
        last_step / dt_s[-1],
    )


def _nearly_level(euler_rad: Array, turns: Array) -> Array:
    """Return the Euler angles (3, N) in the middle of the intervals, to first order in roll and pitch.

    With z = roll + i pitch and psi the change of heading since the start, `z exp(i psi)` changes only by the
    body rates about x and y.
    """
    heading = turns[2].cumsum() - 0.5 * turns[2]
    spun = np.exp(1j * heading)
    tilting = (turns[0] + 1j * turns[1]) * spun
    tilt = (complex(euler_rad[0], euler_rad[1]) + tilting.cumsum() - 0.5 * tilting) * spun.conj()
    return np.array([tilt.real, tilt.imag, euler_rad[2] + heading])


def _euler_increments(euler: Array, turns: Array) -> Array:
    """Return the increments (3, N) of the Euler angles, `E_wb` of eq. (4) times the turns of the body."""
    sr, cr, tp = np.sin(euler[0]), np.cos(euler[0]), np.tan(euler[1])
    level = sr * turns[1] + cr * turns[2]
    return np.array([turns[0] + tp * level, cr * turns[1] - sr * turns[2], level * np.sqrt(1.0 + tp * tp)])


def _increment_derivatives(trig: _Trig, turns: Array) -> Array:
    """Return the derivative (3, 3, N) of the Euler increments with respect to the Euler angles."""
    secant = 1.0 / trig.cp
    tp = trig.sp * secant
    level = trig.sr * turns[1] + trig.cr * turns[2]
    across = trig.cr * turns[1] - trig.sr * turns[2]
    derivatives = np.zeros((3, 3, len(secant)))
    derivatives[0, 0], derivatives[0, 1] = tp * across, level * secant**2
    derivatives[1, 0] = -level
    derivatives[2, 0], derivatives[2, 1] = across * secant, level * tp * secant
    return derivatives


def _forward(trig: _Trig) -> Array:
    """Return the body x axis in the world, first column of `C_wb` (3), for N attitudes, (3, N)."""
    return np.array([trig.cy * trig.cp, trig.sy * trig.cp, -trig.sp])


def _forward_derivatives(trig: _Trig) -> Array:
    """Return the derivative (3, 3, N) of the body x axis with respect to the Euler angles."""
    derivatives = np.zeros((3, 3, len(trig.sp)))
    derivatives[0, 1], derivatives[0, 2] = -trig.cy * trig.sp, -trig.sy * trig.cp
    derivatives[1, 1], derivatives[1, 2] = -trig.sy * trig.sp, trig.cy * trig.cp
    derivatives[2, 1] = -trig.cp
    return derivatives
