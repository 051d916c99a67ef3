"""Statistics of the features themselves, for which every point cloud of a recording is decoded."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyrocal_ros.bag.topic_stats import TurnStats
from gyrocal_ros.data import FeatureObservations, Rig
from gyrocal_ros.errors import MessageError
from gyrocal_ros.model.image_turn import turn_between
from gyrocal_ros.msgs import clouds

NEAR_PART = 0.6
"""Part of width and height of an image within which not all features lie."""


@dataclass(slots=True)
class FeatureStats:
    """Point clouds that cannot be used, features without a place, and the turns that the features show."""

    upward: float
    """1 for a camera that looks up, -1 for one that looks down."""
    size_px: tuple[float, float]
    """Width and height of the image; infinite where they are not known."""
    count: int = 0
    damaged: int = 0
    """Number of clouds that cannot be used."""
    reason: str = ''
    """Why, of the first of them."""
    features: int = 0
    lost: int = 0
    """Number of features without a plausible pixel."""
    with_features: int = 0
    """Number of clouds with a feature that has a place."""
    outside: int = 0
    """Number of features that lie outside of the image."""
    farthest_px: float = 0.0
    """Largest coordinate of a feature."""
    right: int = 0
    below: int = 0
    """Numbers of features in the right and in the lower part of the image, beyond `NEAR_PART`."""
    are_tracked: bool = False
    """True if any feature is in two images."""
    turns: TurnStats = field(default_factory=TurnStats)
    _before: FeatureObservations | None = None
    _yaw_rad: float = 0.0
    _ids: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, rig: Rig) -> FeatureStats:
        """Return the statistics of no cloud yet."""
        camera = rig.camera
        size_px = (camera.width_px, camera.height_px) if camera else (math.inf, math.inf)
        return cls(math.copysign(1.0, rig.camera_mount.R_bs[2, 2]), size_px)

    def add(self, decode: Callable[[], Any]) -> None:
        """Add what is decoded as a PointCloud2 of features."""
        self.count += 1
        try:
            message = decode()
            seen = clouds.features(message)
        except MessageError as error:
            self.damaged += 1
            self.reason = self.reason or error.what
            return
        points = int(message.width) * int(message.height)
        self.features += points
        self.lost += points - len(seen.ids)
        self._see(seen)
        before, self._before = self._before, seen
        turn_rad = turn_between(before, seen) if before is not None else None
        if before is not None and turn_rad is not None:
            self._yaw_rad -= self.upward * turn_rad  # what stays in the room turns the other way
            middle_ns = (before.t_ns + seen.t_ns) // 2
            self.turns.add_headings(np.array([middle_ns]), np.array([self._yaw_rad]))

    def _see(self, seen: FeatureObservations) -> None:
        """Note where the features lie, and whether any of them was seen before."""
        if not len(seen.ids):
            return
        self.with_features += 1
        u, v = seen.pixels.T
        width_px, height_px = self.size_px
        outside = (u < -0.5) | (u > width_px - 0.5) | (v < -0.5) | (v > height_px - 0.5)
        self.outside += int(np.count_nonzero(outside))
        self.farthest_px = max(self.farthest_px, float(np.abs(seen.pixels).max()))
        self.right += int(np.count_nonzero(u > NEAR_PART * width_px))
        self.below += int(np.count_nonzero(v > NEAR_PART * height_px))
        if not self.are_tracked:
            ids = set(seen.ids.tolist())
            self.are_tracked = not self._ids.isdisjoint(ids)
            self._ids = set() if self.are_tracked else self._ids | ids
