"""Likelihood of each feature of an image, for the comparison of models.

Two models do not use the same features: one takes as an outlier what the other explains, a map loses a
feature and the other does not. Their log-likelihoods differ by that far more than by what the models predict.
The log-likelihood of an image less that of a feature given the others is exactly that of the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.history.growing import GrowingColumn
from gyrocal_ros.kernels import compiled


@dataclass(frozen=True, slots=True, eq=False)
class FeatureLikelihoods:
    """The features that the steps of a run have used, n in all."""

    steps: IntArray
    """(n,) numbers of the steps, ascending."""
    ids: IntArray
    """(n,)"""
    log_likelihoods: Array
    """(n,) of each given the other features of its image and all images before."""


class FeatureLikelihoodRecorder:
    """Collects the features that the steps of a run use."""

    def __init__(self) -> None:
        self._steps = GrowingColumn(dtype=np.int32)
        self._ids = GrowingColumn(dtype=np.int64)
        self._log_likelihoods = GrowingColumn(dtype=np.float32)

    def add(self, step: int, update: MeasurementUpdate) -> None:
        """Add the features of a step."""
        self._steps.extend(np.full(len(update.used_ids), step))
        self._ids.extend(update.used_ids)
        self._log_likelihoods.extend(update.given_others)

    def likelihoods(self) -> FeatureLikelihoods:
        """Return all features so far."""
        return FeatureLikelihoods(self._steps.rows(), self._ids.rows(), self._log_likelihoods.rows())


@compiled
def given_others(residual: Array, whitening: Array) -> Array:
    """Return the log-likelihood (m,) of each feature given the others, see `judged.leave_one_out`.

    Args:
        residual: nu (m, r).
        whitening: L^-1 (m r, m r) with `L L^T = S`.
    """
    (m, r), each = residual.shape, np.arange(len(residual))
    precision = whitening.T @ whitening
    own = precision.reshape(m, r, m, r)[each, :, each, :]
    weighted = (precision @ residual.ravel()).reshape(m, r)
    distances = np.sum(weighted * np.linalg.solve(own, weighted[:, :, None])[:, :, 0], axis=1)
    log_likelihoods: Array = -0.5 * (
        distances - np.linalg.slogdet(own).logabsdet + r * math.log(2.0 * math.pi)
    )
    return log_likelihoods
