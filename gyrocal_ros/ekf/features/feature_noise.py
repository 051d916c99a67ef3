"""Noise of each feature: how exactly a patch is matched differs from corner to corner.

Two sources tell the noise of a feature. The tracker knows which patches are matched better than others, image
by image; how large the errors are, it does not know, because most of them do not show in the patch. The
innovations of a feature tell whether it is worse than its patch looks, as a crossing of edges at different
depths, which slides.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.features.judged import Judged
from gyrocal_ros.ekf.state.layout import FeatureNoise, State
from gyrocal_ros.kernels import compiled

PRIOR_OBSERVATIONS = 20.0
"""Observations that the prior, the noise of a typical feature, counts for."""
REMEMBERED_OBSERVATIONS = 100.0
"""Observations after which older ones are forgotten: a patch is seen from elsewhere then."""
MIN_FACTOR = 0.3
"""Smallest variance relative to a typical feature: errors that repeat make a patch look too good."""
MAX_ERROR = 10.0
"""Largest squared error, relative to its variance, that is learned from; beyond it a match is wrong."""
MIN_GAIN = 0.005
"""Gain by which the typical match of the tracker follows changes of light and speed."""


def own_noise(typical: Array, learned: FeatureNoise, rows: IntArray) -> Array:
    """Return the noise (m, 2, 2) of features: that of a typical one (m, 2, 2), times what was learned.

    Args:
        typical: noise by the pixels or by the tracker.
        learned: of all features of the map.
        rows: (m,) indices of the features.

    The factor is the mean of an inverse gamma distribution with the prior 1 (Gelman et al. 2013, sec. 2.6).
    """
    return scaled_noise(typical, learned.weights, learned.sums, rows, PRIOR_OBSERVATIONS, MIN_FACTOR)


@compiled
def scaled_noise(
    typical: Array, weights: Array, sums: Array, rows: IntArray, prior: float, min_factor: float
) -> Array:
    """Return the noise (m, 2, 2) of features; see `own_noise`.

    Args:
        typical: (m, 2, 2)
        weights: (M,) of all features of the map.
        sums: (M,)
        rows: (m,) indices of the features.
        prior: observations that the prior counts for.
        min_factor: smallest variance relative to a typical feature.
    """
    factors = np.maximum((prior + sums[rows]) / (prior + weights[rows]), min_factor)
    return typical * factors[:, None, None]


def learn_noise(state: State, rows: IntArray, judged: Judged, dof: int) -> State:
    """Learn from the features of an image.

    The difference from the prediction by the other features has the noise as a share s of its variance. Given
    the squared Mahalanobis distance d of r degrees of freedom, the noise is expected to be `s d / r + 1 - s`
    times its variance (step E of the EM algorithm, Dempster et al. 1977).

    Args:
        state: with the features in the map.
        rows: (m,) their indices.
        judged: comparison of them with each other.
        dof: r.
    """
    old = state.landmarks.noise
    noise = FeatureNoise(
        *learned_noise(
            old.weights,
            old.sums,
            rows,
            judged.distances,
            judged.noise_share,
            PRIOR_OBSERVATIONS,
            MIN_FACTOR,
            MAX_ERROR,
            1.0 - 1.0 / REMEMBERED_OBSERVATIONS,
            dof,
        )
    )
    return changed(state, landmarks=changed(state.landmarks, noise=noise))


@compiled
def learned_noise(
    weights: Array,
    sums: Array,
    rows: IntArray,
    distances: Array,
    noise_share: Array,
    prior: float,
    min_factor: float,
    max_error: float,
    kept: float,
    dof: float,
) -> tuple[Array, Array]:
    """Return the weights and sums of `FeatureNoise` after an image; see `learn_noise`.

    Args:
        weights: (M,) of all features of the map.
        sums: (M,)
        rows: (m,) indices of the features of the image.
        distances: (m,) squared Mahalanobis distances.
        noise_share: (m,) share of the noise in their variance.
        prior: observations that the prior counts for.
        min_factor: smallest variance relative to a typical feature.
        max_error: largest squared error that is learned from.
        kept: factor by which older observations count less.
        dof: degrees of freedom of a distance.
    """
    errors = noise_share * np.minimum(distances / dof, max_error) + 1.0 - noise_share
    factors = np.maximum((prior + sums[rows]) / (prior + weights[rows]), min_factor)
    weights, sums = weights.copy(), sums.copy()
    weights[rows] = kept * weights[rows] + 1.0
    sums[rows] = kept * sums[rows] + factors * errors / errors.mean()
    return weights, sums


class TypicalMatch:
    """Learns the standard deviation that the tracker tells of a typical match, by its geometric mean."""

    def __init__(self) -> None:
        self._log_std, self._count = 0.0, 0

    @property
    def is_known(self) -> bool:
        """True if the tracker has told any."""
        return self._count > 0

    @property
    def std_px(self) -> float:
        """Standard deviation of a typical match."""
        return math.exp(self._log_std)

    def update(self, covariances_px2: Array) -> None:
        """Learn from the covariances (m, 2, 2) of the features of an image."""
        count = len(covariances_px2)
        if count == 0:
            return
        self._count += count
        log_std = 0.25 * float(np.log(np.linalg.det(covariances_px2)).mean())
        self._log_std += max(count / self._count, MIN_GAIN) * (log_std - self._log_std)
