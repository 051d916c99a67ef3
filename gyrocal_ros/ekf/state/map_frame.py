"""Errors of the map frame, which the filter does not state: its scale and its vertical.

The camera measures directions only, and the first pose defines the frame. An error of the wheels, mainly on
the first metres, in which the depths are found, stretches pose and map together, and a floor that slopes at
the start tilts them. Who compares pose and map with the room sees these errors before all others.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import WheelConfig
from gyrocal_ros.data import Array


def point_covariances(points_m: Array, wheels: WheelConfig) -> Array:
    """Return the covariances (m, 3, 3) that the errors of the frame add to points (m, 3) in it."""
    by_errors = _by_errors(points_m, wheels)
    return by_errors @ by_errors.transpose(0, 2, 1)


def pose_covariance(position_m: Array, yaw_rad: float, wheels: WheelConfig) -> Array:
    """Return the covariance (6, 6) that the errors of the frame add to a pose: x, y, z, roll, pitch, yaw."""
    by_errors = np.zeros((6, 3))
    by_errors[:3] = _by_errors(position_m[None], wheels)[0]
    tilt = math.radians(wheels.floor_tilt_deg)
    by_errors[3:5, 1:] = tilt * np.array(
        [[math.cos(yaw_rad), math.sin(yaw_rad)], [-math.sin(yaw_rad), math.cos(yaw_rad)]]
    )
    return by_errors @ by_errors.T


def _by_errors(points_m: Array, wheels: WheelConfig) -> Array:
    """Return the displacements (m, 3, 3) of points by one deviation of scale, tilt about x and about y."""
    x, y, z = points_m.T
    tilt, none = math.radians(wheels.floor_tilt_deg), np.zeros(len(points_m))
    columns = (wheels.scale_std * points_m.T, tilt * np.array([none, -z, y]), tilt * np.array([z, none, -x]))
    return np.stack(columns).transpose(2, 1, 0)
