"""Depths that become known after the first sight of a feature, and what that changes.

A feature is put where the camera sees it, so its direction errs with the position of the camera, by that
error times the inverse depth. At the first sight the depth is a guess. Where the share by that guess stays,
the next image that corrects the depth seems to tell where the robot is: positions and the size of the map
become certain without reason (Julier and Uhlmann 2001, A counter example to the theory of simultaneous
localization and map building).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.image_model import ImageModel
from gyrocal_ros.ekf.landmarks import position_variance_m2, shift_with_camera
from gyrocal_ros.ekf.state import State
from gyrocal_ros.ekf.update import Innovation
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import PosedCamera, Prediction

MIN_CHANGE = 0.003
"""Change of an inverse depth, relative to its prior standard deviation, that matters."""
MAX_POSITION_STD_M = 0.1
"""Uncertainty of the position, as after a pause, from which terms of second order would matter more."""
MIN_AHEAD = 0.1
"""Smallest depth of a feature, as its point is scaled: 1 where it is as far ahead as at its first sight."""


def with_known_depths(state: State, model: ImageModel, used: Innovation) -> State:
    """Let the directions of features whose depth has changed share the error of the camera by the new depth.

    The present error of the position stands for that at the first sight, by the part of its variance that it
    had then.

    Args:
        state: after the update.
        model: measurement model of the image.
        used: the innovation of the update.
    """
    variance_m2 = position_variance_m2(state)
    if not model.form.is_anchored or not 0.0 < variance_m2 < MAX_POSITION_STD_M**2:
        return state
    change = state.features[used.rows, 2] - used.prediction.scale
    least = MIN_CHANGE * model.config.features.prior_inverse_depth_std
    chosen = (np.abs(change) > least) & (used.prediction.points_c[:, 2] > MIN_AHEAD)
    if not np.count_nonzero(chosen):
        return state
    rows = used.rows[chosen]
    share = np.minimum(state.landmarks.first_variance_m2[rows] / variance_m2, 1.0)
    guessed, known = _from_anchors(state, model.view, rows, share * change[chosen])
    to_direction = -np.linalg.pinv(guessed.by_feature[:, :, :2])

    def more(derivative: Callable[[Prediction], Array | None]) -> Array | None:
        before, after = derivative(guessed), derivative(known)
        return None if before is None or after is None else to_direction @ (after - before)

    return shift_with_camera(
        state,
        rows,
        to_direction @ known.by_pose,
        more(lambda prediction: model.by_values(prediction, state.coefficients)),
        more(model.by_candidates),
    )


def _from_anchors(
    state: State, view: PosedCamera, rows: IntArray, change: Array
) -> tuple[Prediction, Prediction]:
    """Return features (m,) as a camera at their anchors sees them, before and after their depths changed.

    It has the attitude of the present camera, whose error of the position it shares. The derivative by the
    pose is what the change (m,) of the inverse depths adds to it.
    """
    features, anchors = state.features[rows], state.landmarks.anchors[rows]
    R_ca = view.R_wc.T @ anchors.R_wc
    points_c = (R_ca @ np.column_stack([features[:, :2], np.ones(len(rows))])[:, :, None])[:, :, 0]
    pixels, by_point = project_with_jacobian(view.camera, points_c)
    camera_by_pose = np.column_stack([np.eye(3), (view.dR_wb @ view.p_bc).T])
    by_pose = -change[:, None, None] * by_point @ (view.R_wc.T @ camera_by_pose)
    before = features[:, 2] - change
    guessed = Prediction(pixels, np.zeros_like(by_pose), by_point @ R_ca, points_c, by_point, before)
    return guessed, changed(guessed, by_pose=by_pose, scale=features[:, 2])
