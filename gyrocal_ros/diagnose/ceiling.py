"""The map of the ceiling at the end of a run, in the world, whatever numbers the filter keeps it in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.features import PARAMETRISATIONS


@dataclass(frozen=True, slots=True, eq=False)
class CeilingMap:
    """The m features of the map at the end of a run."""

    ids: IntArray
    points_m: Array
    """(m, 3)"""
    covariances_m2: Array
    """(m, 3, 3)"""
    in_view: np.ndarray
    """(m,) bool, seen in the last image; the others are remembered."""

    @property
    def median_std_m(self) -> float:
        """Standard deviation along the longest axis on the floor, of the feature in the middle."""
        return math.sqrt(float(np.median(np.linalg.eigvalsh(self.covariances_m2[:, :2, :2])[:, -1])))

    def outlines(self, sigmas: float, corners: int = 40) -> Array:
        """Ellipses in the floor plane, (m, corners + 1, 2), closed."""
        angle = np.linspace(0.0, 2.0 * math.pi, corners + 1)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        variances, axes = np.linalg.eigh(self.covariances_m2[:, :2, :2])
        half = axes * np.sqrt(np.maximum(variances, 0.0))[:, None, :]
        ellipses: Array = self.points_m[:, None, :2] + sigmas * (half @ circle).transpose(0, 2, 1)
        return ellipses


def ceiling_map(run: Run) -> CeilingMap:
    """Where the mapped features are, and how well that is known."""
    state, landmarks = run.state, run.state.landmarks
    form = PARAMETRISATIONS[run.config.features.parametrisation]
    points, jacobians = form.world(state.features, landmarks.anchors)
    places = state.feature_columns(np.arange(len(landmarks.ids)))
    covariances = state.covariance[places[:, :, None], places[:, None, :]]
    return CeilingMap(
        ids=landmarks.ids,
        points_m=points,
        covariances_m2=jacobians @ covariances @ jacobians.transpose(0, 2, 1),
        in_view=landmarks.last_seen_ns == landmarks.last_seen_ns.max(initial=0),
    )
