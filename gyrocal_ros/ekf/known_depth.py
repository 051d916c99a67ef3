"""Depths that become known after the first sight of a feature, and what that changes.

A feature is put where the camera sees it, so its direction errs with the position of the camera, by that
error times the inverse depth. At the first sight the depth is a guess. Where the share by that guess stays,
the next image that corrects the depth seems to tell where the robot is: positions, the size of the map and
effects of the camera become certain without reason (Julier and Uhlmann 2001, A counter example to the theory
of simultaneous localization and map building).
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.image_model import ImageModel
from gyrocal_ros.ekf.landmarks import position_variance_m2, with_shared_errors
from gyrocal_ros.ekf.state import State
from gyrocal_ros.ekf.update import Innovation, UpdateStats
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import PosedCamera, Prediction

MIN_CHANGE = 0.003
"""Change of an inverse depth, relative to its prior standard deviation, that matters."""
MIN_SHARED_CHANGE = 0.0003
"""The same for the errors of effects, which all later images share."""
MAX_POSITION_STD_M = 0.1
"""Uncertainty of the position, as after a pause, from which terms of second order would matter more."""
MIN_BASELINE = 0.15
"""Way of the camera since the first sight of a feature, relative to its depth, from which it tells the depth
whatever the noise of the wheels is. Spins move a camera on a robot by less."""
MIN_AHEAD = 0.1
"""Smallest depth of a feature, as its point is scaled: 1 where it is as far ahead as at its first sight."""


def with_known_depths(state: State, model: ImageModel, used: Innovation) -> State:
    """Let what a depth multiplies err by the depth that is known now.

    Args:
        state: after the update.
        model: measurement model of the image.
        used: the innovation of the update.
    """
    if not model.form.is_anchored:
        return state
    state = _shared_with_position(state, model, used)
    if not model.depth_matters and not model.effects.camera:
        return state
    rows, change = _changed(state, model, used, MIN_SHARED_CHANGE)
    if len(rows) and model.depth_matters:
        state = _shared_with_effects(state, model, rows, change)
    if len(rows) and model.effects.camera:
        state = _shared_with_lens(state, model, rows, change)
    return state


def _shared_with_position(state: State, model: ImageModel, used: Innovation) -> State:
    """Let directions share the error of the position by the new depth.

    The present error of the position stands for that at the first sight, by the part of its variance that it
    had then.
    """
    variance_m2 = position_variance_m2(state)
    if not 0.0 < variance_m2 < MAX_POSITION_STD_M**2:
        return state
    rows, change = _changed(state, model, used, MIN_CHANGE)
    if not len(rows):
        return state
    change *= np.minimum(state.landmarks.first_variance_m2[rows] / variance_m2, 1.0)
    R_aw = state.landmarks.anchors.R_wc[rows].transpose(0, 2, 1)
    by_pose = directions_by_pose(state.features[rows], R_aw, model.view, change)
    return with_shared_errors(state, _directions(state, rows), np.arange(6), by_pose.reshape(-1, 6))


def _shared_with_effects(state: State, model: ImageModel, rows: IntArray, change: Array) -> State:
    """Let directions share the error of effects that move the camera, by the new depth.

    A coefficient is the same at the first sight and now, so its whole error is shared. The motion of the
    robot at the first sight is taken to be the present one.
    """
    m, now = len(rows), state.features[rows]
    guessed = now - np.outer(change, [0.0, 0.0, 1.0])
    # Both at once: those by the guessed depths come first.
    seen = _from_anchors(np.concatenate([guessed, now]), model.view, np.concatenate([np.zeros(m), change]))

    def added(by_effects: Array) -> Array:
        return directions_by_effects(seen, by_effects[m:] - by_effects[:m]).reshape(2 * m, -1)

    places, k = _directions(state, rows), state.coefficient_columns
    by_values = model.by_values(seen, state.coefficients)
    if by_values is not None:
        state = with_shared_errors(state, places, np.arange(k.start, k.stop), added(by_values))
    if (by_candidates := model.by_candidates(seen)) is not None:
        sensitivity = state.sensitivity.copy()
        sensitivity[places] += added(by_candidates)
        state = changed(state, sensitivity=sensitivity)
    return state


def _shared_with_lens(state: State, model: ImageModel, rows: IntArray, change: Array) -> State:
    """Let depths share the error of effects that make the image larger, by the new depth.

    A focal length that is one per cent too large is made up for by inverse depths that are one per cent too
    small, of whatever they are. Without this, each depth that is corrected would tell of it.
    """
    growth = change[:, None] * relative_growth(state, model, rows)
    depths, k = state.feature_columns(rows)[:, 2], state.coefficient_columns
    return with_shared_errors(state, depths, np.arange(k.start, k.stop), growth)


def relative_growth(state: State, model: ImageModel, rows: IntArray) -> Array:
    """Return by how much directions about features (m,) grow with the coefficients, relative to their size.

    The pixels stay. It is (m, k) half the divergence of the directions, by central differences.
    """
    step = 1e-3
    steps = step * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    features = (state.features[rows] + steps[:, None]).reshape(-1, 3)
    seen = _from_anchors(features, model.view, np.zeros(len(features)))
    by_values = model.by_values(seen, state.coefficients)
    assert by_values is not None
    directions = directions_by_effects(seen, by_values)
    after_a, before_a, after_b, before_b = directions.reshape(4, len(rows), 2, -1)
    growth: Array = ((after_a - before_a)[:, 0] + (after_b - before_b)[:, 1]) / (4.0 * step)
    return growth


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


def _changed(state: State, model: ImageModel, used: Innovation, least: float) -> tuple[IntArray, Array]:
    """Return the indices of the features used whose inverse depth changed, and its changes.

    Changes count from the least one, relative to the prior standard deviation.
    """
    seen = used.prediction
    least *= model.config.features.prior_inverse_depth_std
    chosen, change = changed_depths(
        state.mean, state.robot_size, used.rows, seen.scale, seen.points_c, least, MIN_AHEAD
    )
    return used.rows[chosen], change


def _directions(state: State, rows: IntArray) -> IntArray:
    """Return the indices (2 m,) in the state of the directions of features (m,)."""
    directions: IntArray = state.feature_columns(rows)[:, :2].ravel()
    return directions


def directions_by_pose(features: Array, R_aw: Array, view: PosedCamera, change: Array) -> Array:
    """Return what changes (m,) of inverse depths add to d direction / d pose, (m, 2, 6).

    It is d direction / d camera at the anchor, times d camera / d pose of the present camera.

    Args:
        features: (m, 3)
        R_aw: (m, 3, 3) or (3, 3) from the world to the axes of the anchors.
        view: the present camera.
        change: (m,)
    """
    across = R_aw[..., :2, :] - features[:, :2, None] * R_aw[..., 2:, :]
    camera_by_pose = np.concatenate([np.eye(3), (view.dR_wb @ view.p_bc).T], axis=1)
    return change[:, None, None] * across @ camera_by_pose


def directions_by_effects(seen: Prediction, by_effects: Array) -> Array:
    """Return by how much directions (m, 2, k) make up for effects that move pixels by (m, 2, k).

    Args:
        seen: features as a camera at their anchors sees them, of which the first m count.
        by_effects: derivative of the pixels.
    """
    directions: Array = np.linalg.solve(seen.by_point[: len(by_effects), :, :2], -by_effects)
    return directions


def _from_anchors(features: Array, view: PosedCamera, change: Array) -> Prediction:
    """Return features (m, 3) as a camera at their anchors sees them.

    It moves as the present camera does in its own axes. The derivative by the pose is what changes (m,) of
    the inverse depths add to it.
    """
    points_c = np.column_stack([features[:, :2], np.ones(len(features))])
    pixels, by_point = project_with_jacobian(view.camera, points_c)
    by_feature = by_point * [1.0, 1.0, 0.0]  # no pixel depends on the depth there
    by_pose = -by_feature[:, :, :2] @ directions_by_pose(features, view.R_wc.T, view, change)
    return Prediction(pixels, by_pose, by_feature, points_c, by_point, features[:, 2])
