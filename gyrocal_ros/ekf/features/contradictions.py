"""Features that contradict the others for long: a crossing of edges at different depths is no point.

Where a pipe hides an edge behind it, a tracker follows the crossing well. While it slides slowly, no single
image shows it to be an outlier, but image after image it is farther from where the others expect it than
noise explains. The cumulative sum of that (Page 1954) tells it within some images; a point that is fixed in
space is brought back to zero by the images that it agrees with.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray

ALLOWED, MAX_SUM = 3.0, 15.0
"""Squared distance per degree of freedom, of 1 on average, that an image adds nothing for, and sum of what
exceeds it from which a feature is no fixed point."""
MAX_DISTANCE = 10.0
"""Largest distance that is counted: a wrong match is no lasting contradiction."""
MAX_SHARE = 0.5
"""Share of the features of an image beyond which not they are to blame, but the map or the model."""


class LastingContradictions:
    """Sums up by how much each feature contradicts the others."""

    def __init__(self) -> None:
        self._sums: dict[int, float] = {}

    def find(self, ids: IntArray, distances: Array) -> IntArray:
        """Take the features of an image; return the ids of those that have contradicted the others for long.

        Args:
            ids: (m,)
            distances: (m,) their squared distances from the prediction by the others, per degree of freedom.
        """
        if not len(ids):
            return ids
        # Where most features are off, the model is to blame.
        squares = distances.tolist()
        usual = max(sorted(squares)[len(squares) // 2], 1.0)
        sums, found = {}, []
        for feature, square in zip(ids.tolist(), squares, strict=True):
            total = self._sums.get(feature, 0.0) + min(square / usual, MAX_DISTANCE) - ALLOWED
            if total > MAX_SUM:
                found.append(feature)
            elif total > 0.0:
                sums[feature] = total
        self._sums = sums
        return np.array(found if len(found) <= MAX_SHARE * len(ids) else [], np.int64)
