"""The state of the filter, and the only place that defines its layout.

position (3)  Euler angles (3)  gyro biases (3)  coefficients (k)  features (3 each)  anchors (3 each)
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed, quickly_filled
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.features.base import Anchors, no_anchors

POSITION = slice(0, 3)
EULER = slice(3, 6)
POSE = slice(0, 6)
YAW = 5
BIAS = slice(6, 9)
YAW_BIAS = 8
COEFFICIENTS_START = 9
SCALE = COEFFICIENTS_START - YAW_BIAS
"""Place of the scale factor among yaw bias and coefficients."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class FeatureNoise:
    """Noise of m features, learned from their innovations; see `ekf.features.feature_noise`."""

    weights: Array
    """(m,) number of observations that it was learned from; older ones count less."""
    sums: Array
    """(m,) sum over them of the squared error relative to the pixel noise, 1 on average."""

    def __getitem__(self, rows: IntArray) -> FeatureNoise:
        return FeatureNoise(self.weights[rows], self.sums[rows])

    def joined(self, more: FeatureNoise) -> FeatureNoise:
        """Return the noise of these features and more."""
        weights = np.concatenate([self.weights, more.weights])
        return FeatureNoise(weights, np.concatenate([self.sums, more.sums]))


def unknown_noise(count: int) -> FeatureNoise:
    """Return the noise of features of which nothing is known."""
    return FeatureNoise(np.zeros(count), np.zeros(count))


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Properties of the m mapped features that are not in the state."""

    ids: IntArray
    anchors: Anchors
    """Poses of the camera at the first sight; see `anchor_rows` for their positions."""
    anchor_rows: IntArray
    """(m,) index among the anchors of the state; -1 for a constant one."""
    last_seen_ns: IntArray
    rejections: IntArray
    """Number of consecutive outliers."""
    last_pixels: Array
    """(m, 2) observation that was used last."""
    last_directions: Array
    """(m, 2) expected direction x/z, y/z in the optical frame at that time."""
    noise: FeatureNoise
    """What was learned of their noise."""

    def __getitem__(self, rows: IntArray) -> Landmarks:
        return Landmarks(*(getattr(self, item.name)[rows] for item in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Estimate and covariance at one moment. n = 9 + k + 3 m + 3 a."""

    t_ns: int
    mean: Array
    """(n,)"""
    covariance: Array
    """(n, n)"""
    coefficient_count: int
    """k"""
    landmarks: Landmarks
    sensitivity: Array
    """(n, c) derivative of the estimate with respect to the coefficients of candidate effects; c is 0 without
    candidates."""

    @property
    def robot_size(self) -> int:
        """Index of the first feature: 9 + k."""
        return COEFFICIENTS_START + self.coefficient_count

    @property
    def coefficient_columns(self) -> slice:
        """Indices of the coefficients."""
        return slice(COEFFICIENTS_START, self.robot_size)

    @property
    def position_m(self) -> Array:
        """(3,)"""
        return self.mean[POSITION]

    @property
    def euler_rad(self) -> Array:
        """(3,) roll, pitch, yaw."""
        return self.mean[EULER]

    @property
    def bias_rad_s(self) -> Array:
        """(3,) biases about x, y, z."""
        return self.mean[BIAS]

    @property
    def coefficients(self) -> Array:
        """(k,)"""
        return self.mean[COEFFICIENTS_START : self.robot_size]

    @property
    def features(self) -> Array:
        """(m, 3) parameters of the features."""
        return self.mean[self.robot_size : self.anchors_start].reshape(-1, 3)

    @property
    def anchors_start(self) -> int:
        """Index of the first anchor: 9 + k + 3 m."""
        return self.robot_size + 3 * len(self.landmarks.ids)

    def feature_columns(self, rows: IntArray) -> IntArray:
        """Return the indices (len(rows), 3) of the parameters of the given features in the state."""
        return self.robot_size + 3 * rows[:, None] + np.arange(3)

    @property
    def has_anchors(self) -> bool:
        """True if the anchor of any feature is a state."""
        return len(self.mean) > self.anchors_start

    def anchor_columns(self, rows: IntArray) -> IntArray:
        """Return the index (len(rows),) of the first coordinate of the anchor of features; -1 if constant."""
        if not self.has_anchors:
            return np.full(len(rows), -1)
        places = self.landmarks.anchor_rows.take(rows)
        columns = self.anchors_start + 3 * places
        columns[places < 0] = -1
        return columns

    def anchors_of(self, rows: IntArray) -> Anchors:
        """Return the anchors of features at the present estimate."""
        _, *anchors = features_seen(self, rows)
        return Anchors(*anchors)


@compiled
def features_seen(state: State, rows: IntArray) -> tuple[Array, ...]:
    """Return parameters (m, 3) and the fields of `Anchors` of features (m,) at the present estimate."""
    anchors, start = state.landmarks.anchors[rows], state.anchors_start  # a copy
    places = state.landmarks.anchor_rows[rows]
    free = (places >= 0).nonzero()[0]
    anchors.p_wc[free] = state.mean[start:].reshape(-1, 3)[places[free]]
    return state.features[rows], *(getattr(anchors, item.name) for item in fields(anchors))


def no_landmarks() -> Landmarks:
    """Return an empty map."""
    empty = np.empty(0, np.int64)
    nowhere = np.empty((0, 2))
    return Landmarks(empty, no_anchors(0), empty, empty, empty, nowhere, nowhere, unknown_noise(0))


def with_further_errors(state: State, places: IntArray, std: Array | float) -> State:
    """Return the state with further errors, of standard deviations (p,) or one for all, at places (p,)."""
    covariance = state.covariance.copy()
    covariance[places, places] += np.square(std)
    return changed(state, covariance=covariance)
