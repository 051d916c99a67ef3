"""The map of features as points in the world, for each parametrisation of the filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.model.features import PARAMETRISATIONS


@dataclass(frozen=True, slots=True, eq=False)
class CeilingMap:
    """The m features of a map."""

    t_ns: int
    ids: IntArray
    """(m,)"""
    points_m: Array
    """(m, 3) positions in the map frame."""
    covariances_m2: Array
    """(m, 3, 3)"""
    in_view: np.ndarray
    """(m,) bool, True for features seen in the last image."""

    @property
    def median_std_m(self) -> float:
        """Median over the features of the standard deviation along the longest axis on the floor."""
        return math.sqrt(float(np.median(np.linalg.eigvalsh(self.covariances_m2[:, :2, :2])[:, -1])))

    @property
    def stds_m(self) -> Array:
        """(m, 3) standard deviations along the axes of the map frame."""
        return np.sqrt(np.maximum(np.diagonal(self.covariances_m2, axis1=1, axis2=2), 0.0))

    def outlines(self, sigmas: float, corners: int = 40) -> Array:
        """Return the ellipses in the floor plane as closed polygons (m, corners + 1, 2)."""
        angle = np.linspace(0.0, 2.0 * math.pi, corners + 1)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        variances, axes = np.linalg.eigh(self.covariances_m2[:, :2, :2])
        half = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
        ellipses: Array = self.points_m[:, None, :2] + sigmas * (half @ circle).transpose(0, 2, 1)
        return ellipses


def ceiling_map(state: State, parametrisation: str) -> CeilingMap:
    """Return the mapped features as points, with their covariance relative to the robot's first pose.

    Args:
        state: state of the filter.
        parametrisation: name of the feature parametrisation, as in `features.parametrisation`.
    """
    landmarks = state.landmarks
    rows = np.arange(len(landmarks.ids))
    points, by_feature = PARAMETRISATIONS[parametrisation].world(state.features, state.anchors_of(rows))
    places, anchors = state.feature_columns(rows), state.anchor_columns(rows)
    is_free = (anchors >= 0)[:, None]
    places = np.concatenate([places, np.where(is_free, anchors[:, None] + np.arange(3), 0)], axis=1)
    covariances = state.covariance[places[:, :, None], places[:, None, :]]
    jacobians = np.concatenate([by_feature, is_free[:, :, None] * np.eye(3)], axis=2)
    return CeilingMap(
        t_ns=state.t_ns,
        ids=landmarks.ids,
        points_m=points,
        covariances_m2=jacobians @ covariances @ jacobians.transpose(0, 2, 1),
        in_view=landmarks.last_seen_ns == landmarks.last_seen_ns.max(initial=0),
    )
