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
from gyrocal_ros.ekf.effects_by_place import first_sight_by_values
from gyrocal_ros.ekf.image_model import ImageModel
from gyrocal_ros.ekf.landmarks import position_variance_m2, shift_with_camera
from gyrocal_ros.ekf.state import State
from gyrocal_ros.ekf.update import Innovation, UpdateStats
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import PosedCamera, Prediction

MIN_CHANGE = 0.003
"""Change of an inverse depth, relative to its prior standard deviation, that matters."""
MAX_POSITION_STD_M = 0.1
"""Uncertainty of the position, as after a pause, from which terms of second order would matter more."""
MIN_BASELINE = 0.15
"""Way of the camera since the first sight of a feature, relative to its depth, from which it tells the depth
whatever the noise of the wheels is. Spins move a camera on a robot by less."""
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
    least = MIN_CHANGE * model.config.features.prior_inverse_depth_std
    seen = used.prediction
    chosen, change = changed_depths(
        state.mean, state.robot_size, used.rows, seen.scale, seen.points_c, least, MIN_AHEAD
    )
    if not len(chosen):
        return state
    rows = used.rows[chosen]
    change *= np.minimum(state.landmarks.first_variance_m2[rows] / variance_m2, 1.0)
    by_pose = directions_by_pose(state, model.view, rows, change)
    if not model.depth_matters:
        return shift_with_camera(state, rows, by_pose, None, None)
    guessed, known = _from_anchors(state, model.view, rows, change, by_pose)

    def added(derivative: Callable[[Prediction], Array | None]) -> Array | None:
        before, after = derivative(guessed), derivative(known)
        if before is None or after is None:
            return None
        return first_sight_by_values(guessed, after - before)[:, :2]

    by_values = added(lambda prediction: model.by_values(prediction, state.coefficients))
    return shift_with_camera(state, rows, by_pose, by_values, added(model.by_candidates))


def has_moved(state: State, view: PosedCamera) -> bool:
    """Return True if the camera has moved enough since it saw its features first to tell how far they are.

    Before, position, depth and camera explain the same shifts of the features. The filter, which is linear,
    is too certain of their products; and where the wheels tell noise while the robot does not move, a ceiling
    farther away fits better. So the camera seems to be mounted elsewhere. That lasts where a robot does
    nothing but spin on the spot. Once the size of the map is known, it tells the depth of a new feature.

    Args:
        state: after an update.
        view: the camera.
    """
    landmarks = state.landmarks
    seen = (landmarks.last_seen_ns == state.t_ns).nonzero()[0]
    if not len(seen):
        return False
    way_m = np.linalg.norm(landmarks.anchors.p_wc[seen] - view.p_wc, axis=1)
    return bool(np.median(way_m * state.features[seen, 2]) > MIN_BASELINE)


def weighted_scores(stats: UpdateStats, weights: Array) -> UpdateStats:
    """Return the statistics of an update with the scores of the candidates times weights (c,)."""
    if stats.information is None or stats.score is None:
        return stats
    information = stats.information * np.outer(weights, weights)
    return changed(stats, information=information, score=stats.score * weights)


@compiled
def changed_depths(
    mean: Array,
    first: int,
    rows: IntArray,
    before: Array,
    points_c: Array,
    least: float,
    min_ahead: float,
) -> tuple[IntArray, Array]:
    """Return which of m features have another inverse depth after an update, as indices, and its change.

    Args:
        mean: (n,) after the update.
        first: index of the first feature in it.
        rows: (m,) their indices in the map.
        before: (m,) inverse depths before the update.
        points_c: (m, 3) where they were expected, in the optical frame.
        least: smallest change.
        min_ahead: smallest depth.
    """
    change = mean[first + 3 * rows + 2] - before
    chosen = ((np.abs(change) > least) & (points_c[:, 2] > min_ahead)).nonzero()[0]
    return chosen, change[chosen]


def directions_by_pose(state: State, view: PosedCamera, rows: IntArray, change: Array) -> Array:
    """Return what changes (m,) of inverse depths add to d direction / d pose, (m, 2, 6).

    It is d direction / d camera at the anchor, times d camera / d pose of the present camera.
    """
    R_aw = state.landmarks.anchors.R_wc[rows].transpose(0, 2, 1)
    across = R_aw[:, :2] - state.features[rows, :2, None] * R_aw[:, 2:]
    camera_by_pose = np.concatenate([np.eye(3), (view.dR_wb @ view.p_bc).T], axis=1)
    return change[:, None, None] * across @ camera_by_pose


def _from_anchors(
    state: State, view: PosedCamera, rows: IntArray, change: Array, by_pose: Array
) -> tuple[Prediction, Prediction]:
    """Return features (m,) as a camera at their anchors sees them, before and after their depths changed.

    It has the attitude of the present camera, whose error of the position it shares. The derivative by the
    pose is what the change (m,) of the inverse depths adds to it, given that of the directions (m, 2, 6).
    """
    features = state.features[rows]
    R_ca = view.R_wc.T @ state.landmarks.anchors.R_wc[rows]
    points_c = (R_ca @ np.column_stack([features[:, :2], np.ones(len(rows))])[:, :, None])[:, :, 0]
    pixels, by_point = project_with_jacobian(view.camera, points_c)
    by_feature = by_point @ R_ca * [1.0, 1.0, 0.0]  # no pixel depends on the depth there
    before = features[:, 2] - change
    guessed = Prediction(pixels, np.zeros((len(rows), 2, 6)), by_feature, points_c, by_point, before)
    return guessed, changed(guessed, by_pose=-by_feature[:, :, :2] @ by_pose, scale=features[:, 2])
