"""Tilt of a gyro against the vertical, as levelled by gravity over a run.

A yaw gyro that leans by an angle t reads the yaw rate times cos(t). The levelled filter corrects that by the
readings about x and y. On a floor that is level on average the mean lean is that of the mounting.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.equations.levelling import INITIAL_STD_RAD
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import EULER

BLOCK_S = 10.0
"""Length of the stretches by whose scatter the standard deviation is estimated."""
ACCELEROMETER_STD_RAD = math.radians(0.5)
"""Standard deviation of the lean by the bias of the accelerometer, some 0.1 m/s^2."""


@dataclass(frozen=True, slots=True)
class MountTilt:
    """Mean lean of the gyro against the vertical."""

    roll_rad: float
    pitch_rad: float
    std_rad: float
    """Standard deviation of the angle."""

    @property
    def angle_rad(self) -> float:
        """Angle between the yaw axis of the gyro and the vertical."""
        return math.acos(math.cos(self.roll_rad) * math.cos(self.pitch_rad))

    @property
    def scale_part(self) -> float:
        """Part of the yaw rate that the leaning axis does not read."""
        return 1.0 - math.cos(self.angle_rad)

    def __str__(self) -> str:
        angle_deg, std_deg = math.degrees(self.angle_rad), math.degrees(self.std_rad)
        return (
            f'the gyro leans by {angle_deg:.1f} +- {std_deg:.1f} deg against the vertical '
            f'({100.0 * self.scale_part:.2g} % of the scale factor)'
        )


def mount_tilt(run: Run) -> MountTilt | None:
    """Return the tilt by a levelled run; None with a camera, or where gravity was not followed."""
    history = run.history
    is_levelled = run.rig.camera is None and len(history.t_ns) > 0
    if not is_levelled or history.std[-1, EULER][:2].max() > INITIAL_STD_RAD:
        return None
    return mean_tilt(history.time_s, history.dt_s, history.mean[:, EULER])


def mean_tilt(time_s: Array, dt_s: Array, euler_rad: Array) -> MountTilt:
    """Return the mean tilt over s steps.

    Args:
        time_s: (s,) times.
        dt_s: (s,) durations.
        euler_rad: (s, 3) roll, pitch and yaw.
    """
    roll, pitch = euler_rad[:, 0], euler_rad[:, 1]
    up = np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1)
    block = (time_s / BLOCK_S).astype(int)
    durations = np.bincount(block, dt_s)
    means = np.stack([np.bincount(block, dt_s * column) for column in up.T], axis=1)[durations > 0.0]
    durations = durations[durations > 0.0]
    x, y, z = means.sum(axis=0) / durations.sum()
    blocks = means / durations[:, None]
    scatter = np.sqrt(np.mean(np.var(blocks[:, :2], axis=0)) / max(len(blocks) - 1, 1))
    std_rad = math.hypot(float(scatter), ACCELEROMETER_STD_RAD)
    return MountTilt(math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), std_rad)
