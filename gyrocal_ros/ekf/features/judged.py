"""Comparison of the features of an image with their predictions: each alone, or by all others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, quickly_filled
from gyrocal_ros.ekf.equations.update import Innovation, own_precisions
from gyrocal_ros.ekf.state.positive_definite import inverse
from gyrocal_ros.errors import IndefiniteCovarianceError


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Comparison of each of m features with its prediction."""

    distances: Array
    """(m,) squared Mahalanobis distances, chi-square distributed with r degrees of freedom."""
    noise_share: Array
    """(m,) share of the measurement noise in the variance of the difference."""
    nis: float
    """Normalised innovation squared of all features together; NaN where each is judged alone."""


def mahalanobis(residual: Array, precisions: Array) -> Array:
    """Return the squared Mahalanobis distance (m,) of each innovation (m, r) by its precision (m, r, r)."""
    distances: Array = np.sum((residual[:, None, :] @ precisions)[:, 0] * residual, axis=1)
    return distances


def each_alone(innovation: Innovation) -> Judged:
    """Compare every feature with its prediction by the map alone.

    Raises:
        FilterDivergedError: the covariance of a feature is singular.
    """
    distances = mahalanobis(innovation.residual, own_precisions(innovation))
    total = np.einsum('mii->m', innovation.own_covariances())
    return Judged(distances, np.einsum('mii->m', innovation.noise) / total, np.nan)


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
    try:
        precision = inverse(inflated(innovation, inflation).reshape(m * r, m * r))
        own = np.linalg.inv(precision.reshape(m, r, m, r)[each, :, each, :])
        weighted = (precision @ innovation.residual.ravel()).reshape(m, r)
        difference = (own @ weighted[:, :, None])[:, :, 0]
        if (inflation == 1.0).all():  # variance^-1 difference is y itself
            variance, distances = own, (difference * weighted).sum(axis=1)
        else:
            variance = own - (inflation - 1.0)[:, None, None] * innovation.noise
            distances = mahalanobis(difference, np.linalg.inv(variance))
    except np.linalg.LinAlgError as error:
        raise IndefiniteCovarianceError from error
    if not (distances >= 0.0).all():
        raise IndefiniteCovarianceError
    noise_share = np.einsum('mii->m', innovation.noise) / np.einsum('mii->m', variance)
    return Judged(distances, noise_share, float(np.vdot(weighted, innovation.residual)))


def inflated(innovation: Innovation, inflation: Array) -> Array:
    """Return the covariance (m, r, m, r) with inflated noise."""
    if max(inflation.tolist()) == 1.0:
        return innovation.covariance
    each = np.arange(len(inflation))
    covariance = innovation.covariance.copy()
    covariance[each, :, each, :] += (inflation - 1.0)[:, None, None] * innovation.noise
    return covariance
