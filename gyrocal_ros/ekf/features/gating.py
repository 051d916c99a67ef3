"""Gates: which features to use, and which images."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.state.layout import POSE, YAW, State
from gyrocal_ros.statistics import chi_square_quantile

MIN_FEATURES_FOR_MEDIAN = 4
"""Fewest features whose median distance widens the gate."""


def inliers(distances: Array, dof: int, outlier_probability: float) -> np.ndarray:
    """Return which features to use, (m,) bool, by their squared Mahalanobis distances (m,).

    The gate widens with the median of the image. A fixed gate would reject exactly the images in which an
    effect shows that the model lacks, and leave the filter certain of a wrong estimate.
    """
    bound = chi_square_quantile(1.0 - outlier_probability, dof)
    if len(distances) >= MIN_FEATURES_FOR_MEDIAN:
        middle = (len(distances) - 1) // 2  # the lower of two medians, so that half may be outliers
        median = float(np.partition(distances, middle)[middle])
        bound *= max(1.0, median / chi_square_quantile(0.5, dof))
    return distances <= bound


class MotionGate:
    """The motion gate of the paper's parametrisation: an image counts after some motion only."""

    def __init__(self) -> None:
        self._last_pose: Array | None = None

    def passes(self, state: State, config: FeatureConfig) -> bool:
        """Return True, and remember the pose, if the robot has moved or turned since the last image used."""
        pose = state.mean[POSE]
        if self._last_pose is not None:
            moved = pose - self._last_pose
            is_far = float(np.linalg.norm(moved[:3])) >= config.motion_gate_m
            if not is_far and abs(moved[YAW]) < math.radians(config.motion_gate_deg):
                return False
        self._last_pose = pose.copy()
        return True
