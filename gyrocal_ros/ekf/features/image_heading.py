"""The innovation of an image as an error of the heading, as a report shows it."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.ekf.equations.update import Innovation, own_precisions
from gyrocal_ros.ekf.state.layout import YAW
from gyrocal_ros.kernels import compiled


def as_heading(innovation: Innovation) -> tuple[float, float]:
    """Return the innovation as a heading error, by least squares, and its standard deviation by pixel noise.

    Features are weighted by their own covariance: a new one, of unknown depth, hardly determines the heading.
    The standard deviation is NaN where the measurement is not in pixels.
    """
    if len(innovation.rows) == 0 or innovation.noise.shape[1] != 2:
        return 0.0, float('nan')
    return fit_heading(innovation, YAW)


@compiled
def fit_heading(innovation: Innovation, yaw: int) -> tuple[float, float]:
    """Return the heading error (rad) that fits innovations in pixels best, and its standard deviation.

    Args:
        innovation: of the features; each is weighted by its own covariance.
        yaw: index of the heading in the pose.

    Raises:
        FilterDivergedError: the covariance of a feature is singular.
    """
    by_yaw = innovation.prediction.by_pose[:, :, yaw]
    weighted = (own_precisions(innovation) @ by_yaw[:, :, None])[:, :, 0]
    information = float(np.vdot(weighted, by_yaw))
    variance = float(np.vdot(weighted, (innovation.noise @ weighted[:, :, None])[:, :, 0]))
    return float(np.vdot(weighted, innovation.residual)) / information, math.sqrt(variance) / information
