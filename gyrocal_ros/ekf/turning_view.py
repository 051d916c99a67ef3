"""Features that turn with the camera: dust in the dark, blocks of compression, the inside of a cover.

They stay where they were seen first though the gyro has turned the camera since, and agree with each other:
so it seems that the robot did not turn, and that the gyro is wrong.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.features.base import Anchors, PosedCamera

TURNS_WITH_CAMERA = (
    'what the camera sees turns with it, as dust on the lens in the dark: such images are left out'
)
"""Event of a run."""
STAYS_PX, STAYS_STD = 0.3, 3.0
"""Motion in the image up to which a feature stays, in px or in standard deviations of its noise."""
TURNED = 3.0
"""Motion by the turn alone, relative to that, from which a feature should not be where it was."""
MIN_FEATURES, MIN_SHARE = 3, 2.0 / 3.0
"""Number of such features, and their share of those that should have moved, from which it is no chance."""


def turn_with_camera(
    view: PosedCamera, directions: Array, anchors: Anchors, pixels: Array, noise_px: float
) -> np.ndarray:
    """Return which features of an image turn with the camera: most of them, or none.

    Args:
        view: the camera, as predicted.
        directions: (m, 2) x/z, y/z of the features where they were seen first.
        anchors: camera at that time.
        pixels: (m, 2) observations.
        noise_px: standard deviation of the pixels.

    Returns:
        (m,) bool
    """
    rays = np.column_stack([directions, np.ones(len(directions))])
    turned = (view.R_wc.T @ anchors.R_wc @ rays[:, :, None])[:, :, 0]
    first_px = project(view.camera, rays)
    stays_px = max(STAYS_PX, STAYS_STD * noise_px)
    should_move = _lengths(project(view.camera, turned) - first_px) > TURNED * stays_px
    stays = should_move & (_lengths(pixels - first_px) < stays_px)
    count = np.count_nonzero(stays)
    is_chance = count < MIN_FEATURES or count < MIN_SHARE * np.count_nonzero(should_move)
    return np.zeros(len(stays), bool) if is_chance else stays


def _lengths(vectors: Array) -> Array:
    lengths: Array = np.hypot(vectors[:, 0], vectors[:, 1])
    return lengths
