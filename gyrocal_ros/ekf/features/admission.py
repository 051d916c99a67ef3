"""Which features join the map."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.ekf.equations.update import NO_FEATURES
from gyrocal_ros.ekf.features.landmarks import match_ids
from gyrocal_ros.ekf.features.moving_features import MovingFeatures
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.ekf.state.pauses import at_own_origin


class Admission:
    """Chooses the features of an image that join the map.

    In a full map a new feature takes the place of another one, so it must have been tracked from the image
    before: corners of noise in the dark are new in each image, and would drive out half of the map at once.
    """

    def __init__(self) -> None:
        self._ids_before, self._has_map = NO_FEATURES, False

    def placed(self, state: State) -> State:
        """Return the state to which features are about to be added; for the first ones, at its origin."""
        is_first, self._has_map = not self._has_map, True
        return at_own_origin(state) if is_first else state

    def choose(self, state: State, ids: IntArray, moving: MovingFeatures, map_size: int) -> list[int]:
        """Return the indices of fixed features that are not in the map and for which there is room.

        No feature of the map that was just seen is evicted: one known for longer is worth more.

        Args:
            state: after the update by the image.
            ids: (m,) of the features of the image.
            moving: those that are not fixed.
            map_size: number of features that the map holds.
        """
        before, self._ids_before = self._ids_before, ids
        known, _ = match_ids(state.landmarks.ids, ids)
        if len(known) == len(ids):
            return []
        is_new = np.ones(len(ids), bool)
        is_new[known] = False
        is_new &= moving.are_fixed(ids)
        is_tracked = np.isin(ids, before)
        just_seen = int(np.count_nonzero(state.landmarks.last_seen_ns == state.t_ns))
        tracked = np.flatnonzero(is_new & is_tracked)[: max(map_size - just_seen, 0)]
        free = max(map_size - len(state.landmarks.ids) - len(tracked), 0)
        return sorted([*tracked.tolist(), *np.flatnonzero(is_new & ~is_tracked)[:free].tolist()])
