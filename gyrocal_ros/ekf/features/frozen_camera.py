"""Detection of images that repeat an earlier one while the robot moves: a frozen camera."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import FeatureObservations, MotionBlock

MIN_FEATURES = 3
"""Smallest number of features that are not at the same places by chance."""
MIN_TURN_RAD, MIN_TRAVEL_M = math.radians(0.1), 0.005
"""Motion since an image after which another one shows its features elsewhere, by about half a pixel."""
FROZEN = 'images repeat the one before while the robot moves, so they are left out: is the camera frozen?'
"""Event of a run."""


class FrozenCamera:
    """Compares the features of each image with those of the last one that was new.

    A frozen camera driver, or a node that sends each image twice, publishes equal images with new stamps.
    They would tell the filter that the robot stands still. Noise makes two exposures differ, and so do the
    features found in them; at rest, coarse coordinates may be equal, which then is right.
    """

    def __init__(self) -> None:
        self._last: FeatureObservations | None = None
        self._turned_rad = self._travelled_m = 0.0
        self._is_known = False

    def move(self, block: MotionBlock) -> None:
        """Add the motion of a block."""
        way_m, turn_rad, *_ = block.way_and_turn()
        self._travelled_m += way_m
        self._turned_rad += turn_rad

    def repeats(self, seen: FeatureObservations) -> bool:
        """Return True if an image shows all features where they were before the robot moved."""
        has_moved = abs(self._turned_rad) > MIN_TURN_RAD or abs(self._travelled_m) > MIN_TRAVEL_M
        if self._last is not None and _are_equal(self._last, seen):
            return has_moved
        self._last, self._turned_rad, self._travelled_m = seen, 0.0, 0.0
        return False

    def event(self) -> str:
        """Return the event to report; empty after the first time."""
        is_known, self._is_known = self._is_known, True
        return '' if is_known else FROZEN


def _are_equal(one: FeatureObservations, other: FeatureObservations) -> bool:
    return (
        len(one.ids) >= MIN_FEATURES
        and len(one.ids) == len(other.ids)
        and one.pixels[0, 0] == other.pixels[0, 0]  # usually not
        and np.array_equal(one.pixels, other.pixels)
        and np.array_equal(one.ids, other.ids)
    )
