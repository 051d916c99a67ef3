"""Positive definite matrices, by LAPACK itself: NumPy's general solvers take five times as long."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from gyrocal_ros.data import Array
from gyrocal_ros.errors import IndefiniteCovarianceError


def cholesky(covariance: Array) -> Array:
    """Return the lower triangular L (q, q) of `L L^T = S`.

    Args:
        covariance: S (q, q), symmetric.

    Raises:
        FilterDivergedError: S is not positive definite.
    """
    factor: Array
    factor, failed = lapack.dpotrf(covariance, lower=1)
    if failed:
        raise IndefiniteCovarianceError
    return factor


def whiten(factor: Array, right: Array) -> Array:
    """Return `L^-1 B` for L (q, q) and B (q, ...).

    The inverse of a small L and one product take half the time of a triangular solution.
    """
    whitened: Array = lapack.dtrtri(factor, lower=1)[0] @ right
    return whitened


def inverse(covariance: Array) -> Array:
    """Return the inverse (q, q) of a covariance (q, q).

    Raises:
        FilterDivergedError: it is not positive definite.
    """
    lower: Array = lapack.dpotri(cholesky(covariance), lower=1)[0]
    both = lower + lower.T
    np.fill_diagonal(both, lower.diagonal())
    return both


def solve(matrix: Array, right: Array) -> Array:
    """Return `A^-1 b` for a positive definite A (q, q) and b (q,).

    Raises:
        FilterDivergedError: A is not positive definite.
    """
    solution: Array
    _, solution, failed = lapack.dposv(matrix, right, lower=1)
    if failed:
        raise IndefiniteCovarianceError
    return solution
