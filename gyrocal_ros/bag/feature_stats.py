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


@dataclass(slots=True)
class FeatureStats:
    """Point clouds that cannot be used, features without a place, and the turns that the features show."""

    upward: float
    """1 for a camera that looks up, -1 for one that looks down."""
    count: int = 0
    damaged: int = 0
    """Number of clouds that cannot be used."""
    reason: str = ''
    """Why, of the first of them."""
    features: int = 0
    lost: int = 0
    """Number of features without a plausible pixel."""
    turns: TurnStats = field(default_factory=TurnStats)
    _before: FeatureObservations | None = None
    _yaw_rad: float = 0.0

    @classmethod
    def of(cls, rig: Rig) -> FeatureStats:
        """Return the statistics of no cloud yet."""
        return cls(upward=math.copysign(1.0, rig.camera_mount.R_bs[2, 2]))

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
        before, self._before = self._before, seen
        turn_rad = turn_between(before, seen) if before is not None else None
        if before is not None and turn_rad is not None:
            self._yaw_rad -= self.upward * turn_rad  # what stays in the room turns the other way
            middle_ns = (before.t_ns + seen.t_ns) // 2
            self.turns.add_headings(np.array([middle_ns]), np.array([self._yaw_rad]))
