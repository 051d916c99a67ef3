"""Errors that repeat: the matching error of a patch stays the same while the picture does.

A hundred images of a robot at rest then hold one error a hundred times, and count as one. The autocorrelation
of the errors on images is 0.97 below 0.05 px of motion and 0.4 at 0.4 px.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray, quickly_filled
from gyrocal_ros.ekf.noise.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.state.layout import Landmarks
from gyrocal_ros.kernels import compiled

MIN_MOTION_PX = 0.5
"""Motion in the image from which errors do not repeat."""
REPEATING = 0.5
"""Errors repeat where unmoved features scatter less than this, relative to the pixel noise."""
MIN_SCATTER_PX = 1e-3
MIN_DEPTH = 1e-3
"""Smallest depth (scaled as the points are) of a feature in front of the camera."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion in the image of m features since they were used last."""

    directions: Array
    """(m, 2) expected x/z, y/z in the optical frame."""
    moved_px: Array
    """(m,) distance between where they were and where they are expected."""
    changes_px2: Array
    """(m,) squared change of the observation beyond the expected motion, halved: the difference of two
    errors has twice the variance of one."""

    @property
    def unmoved(self) -> np.ndarray:
        """(m,) bool, True for features that are expected where they were."""
        return self.moved_px < MIN_MOTION_PX


def motion(points_c: Array, pixels: Array, landmarks: Landmarks, rows: IntArray, focal_px: float) -> Motion:
    """Return the motion of features since their last use.

    Args:
        points_c: (m, 3) where they are expected in the optical frame, of any scale.
        pixels: (m, 2) their observations.
        landmarks: the map.
        rows: (m,) indices of the features.
        focal_px: focal length of the camera.
    """
    return Motion(
        *motion_in_image(
            points_c,
            pixels,
            landmarks.last_directions,
            landmarks.last_pixels,
            rows,
            focal_px,
            MIN_DEPTH,
        )
    )


@compiled
def motion_in_image(
    points_c: Array,
    pixels: Array,
    last_directions: Array,
    last_pixels: Array,
    rows: IntArray,
    focal_px: float,
    min_depth: float,
) -> tuple[Array, Array, Array]:
    """Return the fields of `Motion`; see `motion`.

    Args:
        points_c: (m, 3)
        pixels: (m, 2)
        last_directions: (M, 2) of all features of the map, when they were used last.
        last_pixels: (M, 2)
        rows: (m,) indices of the features.
        focal_px: focal length of the camera.
        min_depth: smallest depth that is divided by.
    """
    directions = points_c[:, :2] / np.maximum(points_c[:, 2:], min_depth)
    expected_px = focal_px * (directions - last_directions[rows])
    changes_px = pixels - last_pixels[rows] - expected_px
    return directions, np.hypot(expected_px[:, 0], expected_px[:, 1]), 0.5 * (changes_px**2).sum(axis=1)


class RepeatedErrors:
    """Learns whether the errors of unmoved features repeat; the first images are taken as independent.

    Args:
        noise_px: standard deviation of independent errors.
    """

    def __init__(self, noise_px: float) -> None:
        self._scatter = AdaptiveNoise(noise_px, MIN_SCATTER_PX, 10.0 * noise_px)

    def update(self, changes_px2: Array) -> None:
        """Learn from the changes (m,) of unmoved features."""
        if len(changes_px2):
            self._scatter.update(changes_px2 / self._scatter.std**2, 2)

    def are_expected(self, noise_px: float) -> bool:
        """Return True if unmoved features scatter much less than the pixel noise (standard deviation)."""
        return self._scatter.std < REPEATING * noise_px
