"""Robust update: each feature is judged by the other features of its image.

The prediction of a feature by the map is uncertain by the pose of the robot, which all features share. Given
the other features of the same image that uncertainty is small, so that a wrong match, or a point that is not
fixed in space, shows far more clearly than by its own innovation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.update import Innovation, mahalanobis, not_a_covariance, own_precisions
from gyrocal_ros.statistics import chi_square_quantile

HUBER_BOUND = 3.0
"""Mahalanobis distance above which a feature counts less (Huber 1964). Of normally distributed features,
1 % are farther."""
MAX_INFLATION = 1e6
"""Largest inflation, so that rounding remains small; beyond it a feature has no weight anyway."""
MAX_ITERATIONS = 3
CONVERGED = 0.05
"""Relative change of the weights at which the iteration ends."""
FREE_POSE_STD = np.array([0.3, 0.3, 0.3, 0.1, 0.1, 0.1])
"""Standard deviations (m, rad) of a pose of which nothing is known."""
POSE_DOF = 6
MIN_FEATURES = 8
"""Fewest features of which half determine a pose, with one to spare."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Comparison of each of m features with its prediction."""

    distances: Array
    """(m,) squared Mahalanobis distances, chi-square distributed with r degrees of freedom."""
    noise_share: Array
    """(m,) share of the measurement noise in the variance of the difference."""


def each_alone(innovation: Innovation) -> Judged:
    """Compare every feature with its prediction by the map alone.

    Raises:
        FilterDivergedError: the covariance of a feature is singular.
    """
    distances = mahalanobis(innovation.residual, own_precisions(innovation))
    total = np.einsum('mii->m', innovation.own_covariances())
    return Judged(distances, np.einsum('mii->m', innovation.noise) / total)


def leave_one_out(innovation: Innovation, inflation: Array) -> Judged:
    """Predict every feature from all others.

    With S^-1 of the whole image, its blocks B_ii and y = S^-1 nu, the difference from the prediction by the
    others is B_ii^-1 y_i, with covariance B_ii^-1 (Rasmussen and Williams 2006, eq. 5.12).

    Args:
        innovation: of the m features.
        inflation: (m,) factors on the noise of the features, where they are the others.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    m, r = innovation.residual.shape
    each = np.arange(m)
    extra = (inflation - 1.0)[:, None, None] * innovation.noise
    try:
        precision = np.linalg.inv(_inflated(innovation, inflation).reshape(m * r, m * r))
        own = np.linalg.inv(precision.reshape(m, r, m, r)[each, :, each, :])
        weighted = (precision @ innovation.residual.ravel()).reshape(m, r)
        difference = (own @ weighted[:, :, None])[:, :, 0]
        variance = own - extra
        distances = mahalanobis(difference, np.linalg.inv(variance))
    except np.linalg.LinAlgError as error:
        raise not_a_covariance() from error
    if not (distances >= 0.0).all():
        raise not_a_covariance()
    noise_share = np.einsum('mii->m', innovation.noise) / np.einsum('mii->m', variance)
    return Judged(distances, noise_share)


def robust(
    innovation: Innovation, outlier_probability: float
) -> tuple[Innovation, Judged, np.ndarray] | None:
    """Judge the features of an image by each other: Huber's weights, and a gate.

    Returns:
        The innovation with inflated noise in its covariance, the final comparison of the features, and which
        of them to use, (m,) bool. None where the predicted pose cannot judge them, because most features
        contradict it: an effect that the model lacks has turned it, and those that show the effect best would
        be rejected first.

    Raises:
        FilterDivergedError: the covariance of the innovation is not positive definite.
    """
    if len(innovation.rows) >= MIN_FEATURES and _contradicts_pose(innovation, outlier_probability):
        return None
    inflation, judged = _weights(innovation)
    good = judged.distances <= chi_square_quantile(1.0 - outlier_probability, innovation.residual.shape[1])
    if 2 * good.sum() < len(good):
        return None
    return replace(innovation, covariance=_inflated(innovation, inflation)), judged, good


def _contradicts_pose(innovation: Innovation, outlier_probability: float) -> bool:
    """Return True if the half of the features that agree best contradicts the predicted pose."""
    free = _with_free_pose(innovation)
    inflation, judged = _weights(free)
    close = np.argsort(judged.distances)[: (len(inflation) + 1) // 2]
    by_pose = _nis(innovation, inflation, close) - _nis(free, inflation, close)
    return by_pose > chi_square_quantile(1.0 - outlier_probability, POSE_DOF)


def _weights(innovation: Innovation) -> tuple[Array, Judged]:
    """Return the factors (m,) on the noise of the features, and their final comparison."""
    inflation = np.ones(len(innovation.rows))
    for _ in range(MAX_ITERATIONS):
        judged = leave_one_out(innovation, inflation)
        before, inflation = inflation, np.clip(np.sqrt(judged.distances) / HUBER_BOUND, 1.0, MAX_INFLATION)
        if np.allclose(inflation, before, rtol=CONVERGED):
            break
    return inflation, judged


def _with_free_pose(innovation: Innovation) -> Innovation:
    """Return the innovation as if nothing were known of the pose of the robot."""
    m, r = innovation.residual.shape
    by_pose = (innovation.prediction.by_pose * FREE_POSE_STD).reshape(m * r, POSE_DOF)
    free = innovation.covariance.reshape(m * r, m * r) + by_pose @ by_pose.T
    return replace(innovation, covariance=free.reshape(m, r, m, r))


def _inflated(innovation: Innovation, inflation: Array) -> Array:
    """Return the covariance (m, r, m, r) with inflated noise."""
    each = np.arange(len(inflation))
    covariance = innovation.covariance.copy()
    covariance[each, :, each, :] += (inflation - 1.0)[:, None, None] * innovation.noise
    return covariance


def _nis(innovation: Innovation, inflation: Array, chosen: IntArray) -> float:
    """Return the normalised innovation squared of the features of the given indices."""
    residual = innovation.residual[chosen].ravel()
    covariance = _inflated(innovation, inflation)[chosen][:, :, chosen].reshape((len(residual),) * 2)
    return float(residual @ np.linalg.solve(covariance, residual))
