"""Points that slide: where a beam hides an edge of the ceiling behind it, no point is fixed in space.

A tracker follows such a corner well, so every innovation is small. But all of them push the depth the same
way. The estimate of a fixed point may change by what measurements still have to tell: the variance that it
had less the one that it has.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.kernels import compiled

MAX_SURPRISE = 16.0
"""Squared change of an inverse depth over its variance, of 1 on average, from which a point slides."""
MIN_LEARNED = 0.5
"""Part of its variance that a depth has to lose before its change says anything."""
RENEWED = 8.0
"""Factor by which the variance falls before later changes are counted from the new depth."""


class SlidingPoints:
    """Compares the inverse depths of the map with what they were when less was known of them."""

    def __init__(self) -> None:
        self._ids: IntArray = np.empty(0, np.int64)
        self._depths: Array = np.empty(0)
        self._variances: Array = np.empty(0)

    def find(self, state: State) -> IntArray:
        """Return the ids of features of the map that slide.

        Args:
            state: after an image; features are anchored inverse depths.
        """
        surprises, self._depths, self._variances = compared_depths(
            self._ids, self._depths, self._variances, state, MIN_LEARNED, RENEWED
        )
        self._ids = ids = state.landmarks.ids
        if not max(surprises.tolist(), default=0.0) > MAX_SURPRISE:
            return np.empty(0, np.int64)
        # Where all depths change, not the points are to blame.
        usual = max(float(np.median(surprises[surprises >= 0.0])), 1.0)
        sliding: IntArray = ids[surprises > MAX_SURPRISE * usual]
        return sliding


@compiled
def compared_depths(
    known_ids: IntArray,
    known_depths: Array,
    known_variances: Array,
    state: State,
    min_learned: float,
    renewed: float,
) -> tuple[Array, Array, Array]:
    """Compare estimates with earlier ones.

    Returns (m,) the squared changes over their variances, -1 where too little was learned since to tell, and
    the estimates (m,) and variances (m,) with which later ones are to be compared.

    Args:
        known_ids: (n,) features of earlier estimates.
        known_depths: (n,)
        known_variances: (n,)
        state: present estimates, of m features.
        min_learned: part of its variance that an estimate has to lose.
        renewed: factor by which its variance falls before the present one takes its place.
    """
    ids, columns = state.landmarks.ids, slice(state.robot_size + 2, state.anchors_start, 3)
    depths, variances = state.mean[columns], state.covariance.diagonal()[columns]
    place_of = {feature: place for place, feature in enumerate(known_ids.tolist())}
    places = np.array([place_of.get(feature, -1) for feature in ids.tolist()], np.int64)
    before = np.where(places < 0, depths, np.append(known_depths, 0.0)[places])
    variance = np.where(places < 0, variances, np.append(known_variances, 0.0)[places])
    learned = variance - variances
    tells = learned > min_learned * variance
    surprises = np.where(tells, (depths - before) ** 2 / np.where(tells, learned, 1.0), -1.0)
    is_new = (renewed * variances < variance) | (variances > variance)
    return surprises, np.where(is_new, depths, before), np.where(is_new, variances, variance)
