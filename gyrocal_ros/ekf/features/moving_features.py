"""Features that are not fixed in space: they contradict the others wherever the map puts them."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.ekf.equations.update import MeasurementUpdate
from gyrocal_ros.ekf.features.contradictions import LastingContradictions
from gyrocal_ros.ekf.features.sliding import SlidingPoints
from gyrocal_ros.ekf.state.layout import State

MAX_DROPS = 2
"""Number of times that a feature is removed from the map before it moves: the first place may be wrong."""
MAX_SHARE = 0.5
"""Share of the features in view beyond which not they are to blame, but the map or the model."""


class MovingFeatures:
    """Keeps features that move out of the map while they are in view.

    Those are features that were removed from it again and again, and those that were seen moving: by a robot
    at rest, by their depth, or by what the others of their images expect.
    """

    def __init__(self) -> None:
        self._sliding, self._contradictions = SlidingPoints(), LastingContradictions()
        self._drops: dict[int, int] = {}
        self._seen_moving: set[int] = set()

    def update(self, in_view: IntArray, dropped: IntArray) -> None:
        """Add the features removed after an image, given those that it shows."""
        if not self._drops and not self._seen_moving and not len(dropped):
            return
        for feature in dropped.tolist():
            self._drops[feature] = self._drops.get(feature, 0) + 1
        seen = set(in_view.tolist())
        self._drops = {feature: drops for feature, drops in self._drops.items() if feature in seen}
        self._seen_moving &= seen
        if len(self._removed()) > MAX_SHARE * len(in_view):
            self._drops.clear()

    def find(self, state: State, update: MeasurementUpdate) -> IntArray:
        """Return the ids of features of the map that an image that agrees with it shows to move."""
        sliding, contradicting = self._sliding.find(state), self._contradictions.find(*update.compared)
        if not len(sliding) and not len(contradicting):
            return sliding
        found = {*sliding.tolist(), *contradicting.tolist()}
        self._seen_moving |= found
        return np.array(sorted(found), np.int64)

    def add(self, moving: IntArray) -> None:
        """Add features that were seen moving."""
        self._seen_moving.update(moving.tolist())

    def are_fixed(self, ids: IntArray) -> np.ndarray:
        """Return which features (m,), bool, may be in the map."""
        return ~np.isin(ids, [*self._removed(), *self._seen_moving])

    def _removed(self) -> list[int]:
        return [feature for feature, drops in self._drops.items() if drops >= MAX_DROPS]
