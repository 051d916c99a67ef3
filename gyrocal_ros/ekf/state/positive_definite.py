"""Positive definite matrices: covariances of innovations, and normal equations."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.errors import IndefiniteCovarianceError
from gyrocal_ros.kernels import compiled


@compiled
def whitener(covariance: Array) -> Array:
    """Return L^-1 (q, q) with `L L^T = S`, L lower triangular: it turns an innovation into white noise.

    Args:
        covariance: S (q, q), symmetric.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    try:
        return np.linalg.inv(np.linalg.cholesky(covariance))
    except np.linalg.LinAlgError as error:
        raise IndefiniteCovarianceError from error


def inverse(covariance: Array) -> Array:
    """Return the inverse (q, q) of a covariance (q, q).

    Raises:
        FilterDivergedError: it is not positive definite.
    """
    whitening = whitener(covariance)
    precision: Array = whitening.T @ whitening
    return precision


@compiled
def solve(left: Array, right: Array) -> Array:
    """Return `A^-1 b` for a positive definite A (q, q) and b (q,).

    Raises:
        FilterDivergedError: A is not positive definite.
    """
    whitening = whitener(left)
    solution: Array = whitening.T @ (whitening @ right)
    return solution
