"""What the tracker knows of its features, what it searches for in an image, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.vision.patches import Patches


@dataclass(slots=True, eq=False)
class Features:
    """n features, oldest first."""

    ids: IntArray
    seen_ns: IntArray
    """(n,) time of their last observation."""
    used_ns: IntArray
    """(n,) last time at which the filter had a place for them, or could not say."""
    ceiling: Array
    """(n, 2) ceiling coordinates at that time."""
    outline: Array
    """(n, 9, 2) ceiling coordinates of the nodes of the patch, relative to its centre."""
    first_pixels: IntArray
    """(n, 2) their first observation."""
    first_view: IntArray
    """(n,) number of the view then, see `lens_marks.ViewChange`, or of the last with them elsewhere."""
    patches: Patches

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, chosen: NDArray[np.bool_] | IntArray) -> Features:
        return Features(*(getattr(self, item.name)[chosen] for item in fields(self)))

    def __add__(self, more: Features) -> Features:
        return Features(
            np.concatenate([self.ids, more.ids]),
            np.concatenate([self.seen_ns, more.seen_ns]),
            np.concatenate([self.used_ns, more.used_ns]),
            np.concatenate([self.ceiling, more.ceiling]),
            np.concatenate([self.outline, more.outline]),
            np.concatenate([self.first_pixels, more.first_pixels]),
            np.concatenate([self.first_view, more.first_view]),
            self.patches + more.patches,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SearchSet:
    """The k features to be searched for in an image, with their search regions."""

    index: IntArray
    """(k,) indices of the features."""
    pixels: Array
    """(k, 2) predicted positions."""
    covariances_px2: Array
    """(k, 2, 2) covariances of the predicted positions."""
    tracked: NDArray[np.bool_]
    """(k,) True if found in the last image."""

    def __getitem__(self, chosen: NDArray[np.bool_]) -> SearchSet:
        return SearchSet(*(getattr(self, item.name)[chosen] for item in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Result of the search for k features."""

    pixels: Array
    """(k, 2)"""
    covariances_px2: Array
    """(k, 2, 2)"""
    score: Array
    """(k,) correlation, -1 if the match is rejected."""

    def __setitem__(self, chosen: NDArray[np.bool_], better: Match) -> None:
        for item in fields(self):
            getattr(self, item.name)[chosen] = getattr(better, item.name)
