"""Slow errors of tracks: a matching error that changes with the view, not from image to image.

Compression, a blurred lens, and edges at two depths shift a patch by an amount that lasts while the view is
nearly the same. The map absorbs it, and a hundred images repeat it. So a feature walks at random with its
motion in the image. The walk is as large as it must be to make successive innovations independent: those of
an optimal filter are (Mehra 1970).
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.features.landmarks import match_ids, with_walk
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.kernels import compiled

LEAST_PX, MOST_PX = 1e-6, 1e-4
"""Bounds of the variance of the walk, px^2 per px of motion. Near the lower one it is none; the upper one is
0.1 px in 100 px, as in strongly compressed images. What goes beyond is no error of the tracks."""
MAX_MOTION_PX = 300.0
"""Motion in the image from which errors do not change any more."""
TOLERATED = 0.05
"""Correlation of successive innovations up to which they count as independent."""
GAIN = 0.013
"""Step of the logarithm of the variance by two successive innovations, relative to their product."""
MAX_INNOVATION = 3.0
"""Largest innovation, in standard deviations, that is learned from (Huber 1964)."""


class SlowErrors:
    """Learns the walk of the features by the correlation of their successive innovations."""

    def __init__(self) -> None:
        self._log_variance_px = math.log(LEAST_PX)
        self._ids: IntArray = np.empty(0, np.int64)
        self._errors: Array = np.empty((0, 2))

    @property
    def variance_px(self) -> float:
        """Variance of the walk, px^2 per px of motion in the image; 0 where innovations are independent."""
        variance_px = math.exp(self._log_variance_px)
        return variance_px if variance_px > 2.0 * LEAST_PX else 0.0

    def learn(self, ids: IntArray, errors: Array) -> None:
        """Learn from the features of an image.

        Args:
            ids: (m,)
            errors: (m, 2) their `differences`; NaN for those that have not moved since the last image.
        """
        bounded, products, again = products_with_last(ids, errors, self._ids, self._errors, MAX_INNOVATION)
        step = GAIN * (0.5 * products - TOLERATED * again)
        log_variance_px = min(self._log_variance_px + step, math.log(MOST_PX))
        self._log_variance_px = max(log_variance_px, math.log(LEAST_PX))
        self._ids, self._errors = ids, bounded


@compiled
def products_with_last(
    ids: IntArray, errors: Array, last_ids: IntArray, last_errors: Array, longest: float
) -> tuple[Array, float, int]:
    """Return errors (m, 2) of bounded length, the sum of their products with the last ones, and how many.

    Args:
        ids: (m,) features of an image.
        errors: (m, 2) their errors; NaN for those that tell nothing.
        last_ids: (l,) features of the last image.
        last_errors: (l, 2) what was returned for them.
        longest: bound of the length.
    """
    lengths = np.sqrt((errors**2).sum(axis=1, keepdims=True))
    bounded = errors * np.minimum(1.0, longest / np.maximum(lengths, longest))
    again, before = match_ids(last_ids, ids)
    products = (bounded[again] * last_errors[before]).sum(axis=1)
    tell = ~np.isnan(products)
    return bounded, float(products[tell].sum()), int(tell.sum())


@compiled
def differences(residual: Array, whitening: Array, common: Array) -> Array:
    """Return the difference (m, r) of each feature of an image from the others, with unit covariance.

    What features have in common is taken away first, as if nothing were known of it: a pose or a camera that
    is wrong, because the model lacks something, is no error of the tracks. Too few features do not differ.

    Args:
        residual: nu (m, r).
        whitening: L^-1 (m r, m r) with `L L^T = S`.
        common: (m, r, q) derivative of the prediction by what they have in common.
    """
    (m, r), each, q = residual.shape, np.arange(len(residual)), common.shape[2]
    if m * r < 2 * q:
        return np.empty((0, r))
    axes = np.linalg.qr(whitening @ common.reshape(m * r, q))[0]
    whitened = whitening @ residual.ravel()
    left = whitening.T @ np.column_stack([whitened - axes @ (axes.T @ whitened), axes])
    precision = whitening.T @ whitening - left[:, 1:] @ left[:, 1:].T
    own = precision.reshape(m, r, m, r)[each, :, each, :]
    try:
        different: Array = np.linalg.solve(np.linalg.cholesky(own), left[:, 0].reshape(m, r, 1))[:, :, 0]
    except np.linalg.LinAlgError:  # a feature on which alone something in common depends
        return np.empty((0, r))
    return different


def with_slow_errors(
    state: State, rows: IntArray, moved_px: Array, variance_px: float, focal_px: float
) -> State:
    """Return the state where features have walked with their motion in the image.

    Args:
        state: features are anchored inverse depths.
        rows: (m,) indices of the features.
        moved_px: (m,) their motion since they were used last.
        variance_px: variance of the walk, px^2 per px.
        focal_px: focal length of the camera.
    """
    return with_walk(state, rows, variance_px / focal_px**2 * np.minimum(moved_px, MAX_MOTION_PX))
