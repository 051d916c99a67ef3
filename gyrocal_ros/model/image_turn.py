"""The turn of an image about the optical axis, by the features that it shares with the one before."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import FeatureObservations

MIN_FEATURES = 3
"""Number of features that two images have to share."""


def turn_between(before: FeatureObservations, after: FeatureObservations) -> float | None:
    """Return the turn (rad) of the image about the optical axis; None where too few features are shared.

    It is the rotation between two sets of points about their means that fits best (Kabsch 1976).
    """
    old, new = before.pixels, after.pixels
    if not np.array_equal(before.ids, after.ids):  # most images show the features of the one before
        _, first, second = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
        old, new = old[first], new[second]
    if len(old) < MIN_FEATURES:
        return None
    (a, b), (c, d) = (old - old.sum(axis=0) / len(old)).T, (new - new.sum(axis=0) / len(new)).T
    return math.atan2(a @ d - b @ c, a @ c + b @ d)
