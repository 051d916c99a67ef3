"""Robust update: each feature is judged by the other features of its image.

The prediction of a feature by the map is uncertain by the pose of the robot, which all features share. Given
the other features of the same image that uncertainty is small, so that a wrong match, or a point that is not
fixed in space, shows far more clearly than by its own innovation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.update import Innovation, mahalanobis, not_a_covariance, own_precisions

HUBER_BOUND = 2.5
"""Mahalanobis distance above which a feature counts less (Huber 1964). Of normally distributed features,
4 % are farther."""
MAX_ITERATIONS = 3
CONVERGED = 0.05
"""Relative change of the weights at which the iteration ends."""


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
        FilterDivergedError: S is singular.
    """
    m, r = innovation.residual.shape
    each = np.arange(m)
    extra = (inflation - 1.0)[:, None, None] * innovation.noise
    covariance = innovation.covariance.copy()
    covariance[each, :, each, :] += extra
    try:
        precision = np.linalg.inv(covariance.reshape(m * r, m * r))
        own = np.linalg.inv(precision.reshape(m, r, m, r)[each, :, each, :])
        weighted = (precision @ innovation.residual.ravel()).reshape(m, r)
        difference = (own @ weighted[:, :, None])[:, :, 0]
        variance = own - extra
        distances = mahalanobis(difference, np.linalg.inv(variance))
    except np.linalg.LinAlgError as error:
        raise not_a_covariance() from error
    noise_share = np.einsum('mii->m', innovation.noise) / np.einsum('mii->m', variance)
    return Judged(distances, noise_share)


def robust(innovation: Innovation) -> tuple[Innovation, Judged]:
    """Inflate the noise of the features that the others contradict, by Huber's weights.

    Returns:
        The innovation with inflated noise in its covariance, and the final comparison of the features.

    Raises:
        FilterDivergedError: the covariance of the innovation is singular.
    """
    inflation = np.ones(len(innovation.rows))
    for _ in range(MAX_ITERATIONS):
        judged = leave_one_out(innovation, inflation)
        before, inflation = inflation, np.maximum(1.0, np.sqrt(judged.distances) / HUBER_BOUND)
        if np.allclose(inflation, before, rtol=CONVERGED):
            break
    each = np.arange(len(inflation))
    covariance = innovation.covariance.copy()
    covariance[each, :, each, :] += (inflation - 1.0)[:, None, None] * innovation.noise
    return replace(innovation, covariance=covariance), judged
