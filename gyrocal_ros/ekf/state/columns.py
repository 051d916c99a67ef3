"""Columns of derivatives: those of some effects at the places of their coefficients among all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled


@compiled
def gained(gain: Array, parts: Sequence[Array], starts: Sequence[int], count: int) -> Array:
    """Return the products (p, count) of a gain (p, N) with columns (N, k) that belong at some of the places.

    Args:
        gain: (p, N)
        parts: columns (N, k) each.
        starts: place of the first of each of them.
        count: number of places; others are zero.
    """
    products = np.zeros((len(gain), count))
    for part, start in zip(parts, starts, strict=True):
        products[:, start : start + part.shape[1]] = gain @ part
    return products


@compiled
def side_by_side(parts: Sequence[Array], starts: Sequence[int], count: int) -> Array:
    """Return derivatives (m, 2, K) of m pixels whose columns (m, 2, k) belong at some of the places.

    Args:
        parts: columns (m, 2, k) each, of one effect or more.
        starts: place of the first of each of them.
        count: K; other columns are zero.
    """
    by_values = np.zeros((len(parts[0]), 2, count))
    for part, start in zip(parts, starts, strict=True):
        by_values[:, :, start : start + part.shape[2]] = part
    return by_values
