"""Anchors that move with the position of the robot.

The anchor of a feature, the place of the camera at the first sight, is no part of the state. But what moves
the estimated robot has moved it at the first sight as well, by the part of the error that both share; what
moves the camera on the robot has moved it at every sight. If the anchor stayed, the camera would seem to have
left it. By that parallax, which is none, the noise of the images would tell how far the features are: a robot
at rest would know its ceiling, and each correction of an effect of the camera would seem to confirm it.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, changed
from gyrocal_ros.ekf.effects_by_place import true_camera
from gyrocal_ros.ekf.image_model import ImageModel
from gyrocal_ros.ekf.landmarks import position_variance_m2
from gyrocal_ros.ekf.state import State
from gyrocal_ros.kernels import compiled

MIN_AHEAD = 0.1
"""Smallest depth of a feature from a moved anchor, relative to that before."""


def with_moved_anchors(before: State, after: State, model: ImageModel) -> State:
    """Move the anchors with the position of the robot, and with the camera on it.

    The direction of a feature has been corrected instead, at the inverse depth before the update; that is
    taken back.

    Args:
        before: before an update, with the same features.
        after: after it.
        model: measurement model of the image.
    """
    if not model.form.is_anchored:
        return after
    landmarks, anchors = after.landmarks, after.landmarks.anchors
    mean, p_wc = moved_anchors(
        after.mean,
        after.robot_size,
        before.mean,
        position_variance_m2(before),
        landmarks.first_variance_m2,
        _lever_change_m(after, model),
        anchors.R_wc,
        anchors.p_wc,
        MIN_AHEAD,
    )
    return changed(after, mean=mean, landmarks=changed(landmarks, anchors=changed(anchors, p_wc=p_wc)))


@compiled
def moved_anchors(
    mean: Array,
    first: int,
    mean_before: Array,
    variance_m2: float,
    first_variance_m2: Array,
    lever_change_m: Array,
    R_wc: Array,
    p_wc: Array,
    min_ahead: float,
) -> tuple[Array, Array]:
    """Return the mean (n,) and the positions (m, 3) of the anchors of m features after an update.

    Args:
        mean: after the update, (n,).
        first: index of the first feature in it.
        mean_before: (n,)
        variance_m2: of the position of the robot before the update.
        first_variance_m2: (m,) the same at the first sight of each feature.
        lever_change_m: (3,) by which the camera was moved on the robot, in camera axes.
        R_wc: (m, 3, 3) attitudes of the anchors.
        p_wc: (m, 3) their positions.
        min_ahead: smallest depth that a feature may have from the moved anchor, relative to that before.
    """
    shares = np.minimum(first_variance_m2 / variance_m2, 1.0) if variance_m2 > 0.0 else np.zeros(len(p_wc))
    way_m = shares[:, None] * (mean[:3] - mean_before[:3]) + R_wc @ lever_change_m
    features, inverse_depths = mean[first:].reshape(-1, 3), mean_before[first + 2 :: 3]
    rays = np.column_stack([features[:, :2], np.ones(len(features))])
    rays = rays - inverse_depths[:, None] * (way_m[:, None, :] @ R_wc)[:, 0]
    ahead = rays[:, 2] > min_ahead
    moved = mean.copy()
    moved[first:].reshape(-1, 3)[ahead] = (
        np.column_stack([rays[:, :2], features[:, 2]])[ahead] / rays[ahead, 2:]
    )
    return moved, p_wc + ahead[:, None] * way_m


def _lever_change_m(state: State, model: ImageModel) -> Array:
    """Return the change (3,) of the position of the camera on the robot since the image, in camera axes."""
    if not model.effects.camera:
        return np.zeros(3)
    rig, view = model.rig, model.view
    assert rig.camera is not None
    _, mount = true_camera(model.effects, rig.camera, rig.camera_mount, state.coefficients)
    return (mount.p_bs - view.p_bc) @ view.R_bc
