"""The map of the ceiling, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.slam import EkfSlam


@dataclass(frozen=True, slots=True, eq=False)
class Ceiling:
    """The m features of a map."""

    t_ns: int
    ids: IntArray
    """(m,)"""
    points_m: Array
    """(m, 3) in the map."""
    covariances_m2: Array
    """(m, 3, 3)"""


def ceiling(slam: EkfSlam) -> Ceiling:
    """The features of a filter as points, with how well each is known beside the robot's first view of it."""
    state = slam.state
    points, by_parameters = slam.parametrisation.world(state.features, state.landmarks.anchors)
    columns = state.feature_columns(np.arange(len(points)))
    own = state.covariance[columns[:, :, None], columns[:, None, :]]
    return Ceiling(
        state.t_ns, state.landmarks.ids, points, by_parameters @ own @ by_parameters.transpose(0, 2, 1)
    )
