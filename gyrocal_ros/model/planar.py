"""Fast variants of the dead reckoning, eq. (2), whose one full form is `kinematics.integrate`.

They return no derivatives. Each docstring states how far it agrees with `integrate`: the order of the error
in the length of the step, and in the tilt.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from gyrocal_ros.data import Array

Three: TypeAlias = tuple[float, float, float]
Pose: TypeAlias = tuple[float, float, float, float, float, float]
"""Position (m) and roll, pitch, yaw (rad)."""


def step_pose(pose: Pose, rate_rad_s: Three, dt_s: float, speed_m_s: float) -> Pose:
    """Carry a pose over one short step by eq. (2), in plain floats, which are fastest for a single step.

    The Euler rates, eq. (4), are those at the beginning of the step. The difference from `integrate` is of
    second order in the length of one step, hence of first order over a given time. On a level floor there is
    none: the yaw is exact, and both take the heading in the middle of the step.

    Args:
        pose: at the beginning of the step.
        rate_rad_s: true body rates, mean over the step.
        dt_s: length of the step.
        speed_m_s: along body x.
    """
    x, y, z, roll, pitch, yaw = pose
    wx, wy, wz = rate_rad_s
    sr, cr, tp = math.sin(roll), math.cos(roll), math.tan(pitch)
    level = sr * wy + cr * wz
    turn = level * math.sqrt(1.0 + tp * tp) * dt_s
    middle, way = yaw + 0.5 * turn, speed_m_s * math.cos(pitch) * dt_s
    return (
        x + way * math.cos(middle),
        y + way * math.sin(middle),
        z - speed_m_s * math.sin(pitch) * dt_s,
        roll + (wx + tp * level) * dt_s,
        pitch + (cr * wy - sr * wz) * dt_s,
        yaw + turn,
    )


def step_nearly_level(euler_rad: Three, turn_rad: Three, kept: float = 1.0) -> Three:
    """Carry the attitude of a nearly level body over one short step by eq. (2), linear in roll and pitch.

    Roll and pitch differ from `integrate` by second order in the length of one step, hence by first order
    over a given time. The yaw takes the turn about the body's z axis as it is, an error of second order in
    the tilt; on a level floor it is exact.

    Args:
        euler_rad: roll, pitch, yaw at the beginning of the step.
        turn_rad: turns about the axes of the body during the step.
        kept: factor by which roll and pitch decay to level; 1 for eq. (2) itself.
    """
    roll, pitch, yaw = euler_rad
    x, y, z = turn_rad
    return kept * (roll + x + pitch * z), kept * (pitch + y - roll * z), yaw + z


def planar_trajectory(first_yaw_rad: float, turn_rad: Array, distance_m: Array) -> tuple[Array, Array]:
    """Integrate dead reckoning on a level floor: eq. (2) with roll and pitch zero, s steps at once.

    The heading in the middle of each step gives its direction, as in `integrate`, so both agree for the
    same steps. Where a step combines several intervals, the error of the position is of second order in
    the length of the steps; the yaw is exact.

    Args:
        first_yaw_rad: heading after the first step.
        turn_rad: (s,) turns of the steps, to the left positive.
        distance_m: (s,) way of the steps along body x.

    Returns:
        Position (s, 2) after each step, from where the first one began, and yaw (s,) after each step.
    """
    yaw = first_yaw_rad + np.cumsum(turn_rad) - turn_rad[0]
    heading = yaw - 0.5 * turn_rad
    steps = np.stack([np.cos(heading), np.sin(heading)], axis=1) * distance_m[:, None]
    return np.cumsum(steps, axis=0), yaw
