"""Images of what turns with the camera: dust in the dark, blocks of compression, a cover, an old picture.

Features stay though the gyro turns the camera, and agree with each other: it seems that the robot did not
turn, and that the gyro is wrong.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.equations.update import NO_FEATURES
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.state.layout import YAW, State, features_seen
from gyrocal_ros.model.camera import project
from gyrocal_ros.model.features.base import Anchors, PosedCamera

TURNS_WITH_CAMERA = (
    'what the camera sees turns with it, as dust on the lens in the dark, or the gyro is far off: such '
    'images are left out'
)
"""Event of a run."""
STAYS_PX, STAYS_STD = 0.3, 3.0
"""Motion in the image up to which a feature stays, in px or in standard deviations of its noise."""
TURNED = 3.0
"""Motion by the turn alone, relative to that, from which a feature should not be where it was."""
MIN_FEATURES, MIN_SHARE = 3, 2.0 / 3.0
"""Number of such features, and their share of those that should have moved, from which it is no chance."""


def fixed_to_camera(state: State, model: ImageModel, rows: IntArray, pixels: Array) -> tuple[bool, IntArray]:
    """Tell whether an image that contradicts the predicted pose shows what turns with the camera.

    Features that stay where they were first seen are none of the room. Features of the room may stay in a
    picture that is repeated, with other noise, while the robot turns.

    Args:
        state: as predicted.
        model: of the image.
        rows: (m,) indices of its features in the map.
        pixels: (m, 2) where they are.

    Returns:
        True for such an image, and the ids of the features that are none of the room.
    """
    stays_px = max(STAYS_PX, STAYS_STD * model.noise_px)
    parameters, *anchors = features_seen(state, rows)
    fixed = turn_with_camera(model.view, parameters[:, :2], Anchors(*anchors), pixels, stays_px)
    if fixed.any():
        return True, state.landmarks.ids[rows[fixed]]
    camera, turn_rad = model.view.camera, float(model.motion.rate[YAW]) * model.interval_s
    lever_px = _lengths(pixels - np.array([camera.cx_px, camera.cy_px]))
    stay = _lengths(pixels - state.landmarks.last_pixels[rows]) < stays_px
    return bool(_most(stay, lever_px * abs(turn_rad) > TURNED * stays_px).any()), NO_FEATURES


def turn_with_camera(
    view: PosedCamera, directions: Array, anchors: Anchors, pixels: Array, stays_px: float
) -> np.ndarray:
    """Return which features stay where they were first seen though the camera has turned: most, or none.

    Args:
        view: the camera, as predicted.
        directions: (m, 2) x/z, y/z of the features where they were seen first.
        anchors: camera at that time.
        pixels: (m, 2) observations.
        stays_px: motion in the image up to which a feature stays.

    Returns:
        (m,) bool
    """
    rays = np.column_stack([directions, np.ones(len(directions))])
    turned = (view.R_wc.T @ anchors.R_wc @ rays[:, :, None])[:, :, 0]
    first_px = project(view.camera, rays)
    should_move = _lengths(project(view.camera, turned) - first_px) > TURNED * stays_px
    return _most(_lengths(pixels - first_px) < stays_px, should_move)


def _most(stay: np.ndarray, should_move: np.ndarray) -> np.ndarray:
    """Return which features (m,), bool, stay but should move, if these are most of those that should."""
    found = stay & should_move
    count = np.count_nonzero(found)
    is_chance = count < MIN_FEATURES or count < MIN_SHARE * np.count_nonzero(should_move)
    return np.zeros(len(found), bool) if is_chance else found


def _lengths(vectors: Array) -> Array:
    lengths: Array = np.hypot(vectors[:, 0], vectors[:, 1])
    return lengths
