"""Depths that become known, and the errors that they share.

An image tells products: of the inverse depth and the way of the camera since the first sight, or the focal
length. An error of the one is made up for by the other, in proportion to its size. At the first sight the
depth is a guess. Where the proportion stays that of the guess, each image that corrects the depth seems to
tell the other one alone: the size of the map and effects of the camera become certain without reason.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.equations.update import Innovation, UpdateStats
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.features.landmarks import with_shared_errors
from gyrocal_ros.ekf.state.layout import POSITION, State
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import PosedCamera, Prediction

MIN_CHANGE = 0.003
"""Change of an inverse depth, relative to its prior standard deviation, that matters."""
OFF_AXIS = 0.5
"""Direction x/z of a ray beside the optical axis."""
MIN_BASELINE = 0.15
"""Way of the camera since the first sight of a feature, relative to its depth, from which it tells the depth
whatever the noise of the wheels is. Spins move a camera on a robot by less."""
MIN_AHEAD = 0.1
"""Smallest depth of a feature, as its point is scaled: 1 where it is as far ahead as at its first sight."""


def with_known_depths(state: State, model: ImageModel, used: Innovation) -> State:
    """Let what makes up for a depth err by the depth that is known now.

    Args:
        state: after the update.
        model: measurement model of the image.
        used: the innovation of the update.
    """
    if not model.form.is_anchored or not (state.has_anchors or model.effects.camera):
        return state
    rows, change = _changed(state, model, used)
    if not len(rows):
        return state
    if model.effects.camera:
        state = _shared_with_lens(state, model, rows, change)
    return _shared_with_way(state, model, rows, change) if state.has_anchors else state


def _shared_with_way(state: State, model: ImageModel, rows: IntArray, change: Array) -> State:
    """Let depths share the error of the way from the anchor to the camera, by the new depth.

    A way that is one per cent too long is made up for by an inverse depth that is one per cent too small, of
    whatever it is. Without this, the size of the map stays that of its first metre.
    """
    rows, by_anchor, causes, by_causes = shared_ways(state, rows, change, model.view.p_wc, MIN_BASELINE)
    if not len(rows):
        return state
    depths, moving = state.robot_size + 3 * rows + 2, state.landmarks.anchors
    if moving.by_values.shape[2]:
        now = camera_by_effects(model.view, lambda seen: model.by_values(seen, state.coefficients))
        k = state.coefficient_columns
        causes = np.concatenate([causes, np.arange(k.start, k.stop)])
        by_values = (by_anchor[:, None, :] @ (moving.by_values[rows] - now))[:, 0]
        by_causes = np.concatenate([by_causes, by_values], axis=1)
    state = with_shared_errors(state, depths, causes, by_causes)
    if moving.by_candidates.shape[2]:
        now = camera_by_effects(model.view, model.by_candidates)
        sensitivity = state.sensitivity.copy()
        sensitivity[depths] += (by_anchor[:, None, :] @ (moving.by_candidates[rows] - now))[:, 0]
        state = changed(state, sensitivity=sensitivity)
    return state


@compiled
def shared_ways(
    state: State, rows: IntArray, change: Array, camera_m: Array, least: float
) -> tuple[IntArray, Array, IntArray, Array]:
    """Return which features (f,) share the error of their way, and how their depths err with its ends.

    The anchor is a state, and the way long enough: a short one, as in spins, tells no depth.

    Args:
        state: after an update.
        rows: (m,) indices of the features whose inverse depth has changed.
        change: (m,) its changes.
        camera_m: (3,) where the camera is.
        least: smallest way, relative to the depth.

    Returns:
        Indices (f,) and what is added to d depth / d anchor (f, 3); places (p,) of the position and of the
        anchors in the state, and what is added to d depth by them (f, p).
    """
    free = (state.landmarks.anchor_rows[rows] >= 0).nonzero()[0]
    rows, change = rows[free], change[free]
    ways_m = state.mean[state.anchor_columns(rows)[:, None] + np.arange(3)] - camera_m
    squares_m2 = np.sum(ways_m**2, axis=1)
    tells = (np.sqrt(squares_m2) * state.features[rows, 2] > least).nonzero()[0]
    rows, by_anchor = rows[tells], -(change[tells] / squares_m2[tells])[:, None] * ways_m[tells]
    columns = state.anchor_columns(rows)
    anchors = np.unique(columns)
    by_anchors = by_anchor[:, None, :] * (columns[:, None] == anchors)[:, :, None]
    causes = np.concatenate([np.arange(POSITION.stop), (anchors[:, None] + np.arange(3)).ravel()])
    by_causes = np.concatenate([-by_anchor, by_anchors.reshape(len(rows), 3 * len(anchors))], axis=1)
    return rows, by_anchor, causes, by_causes


def camera_by_effects(view: PosedCamera, by_effects: Callable[[Prediction], Array | None]) -> Array:
    """Return the derivative (3, k) of the position of the camera by effects, in the world.

    It is what moves a feature at unit depth, but none that is infinitely far.

    Args:
        view: the camera.
        by_effects: returns the derivative (m, 2, k) of a prediction by coefficients; None without any.
    """
    rays = np.array([[0.0, 0.0, 0.0], [OFF_AXIS, 0.0, 0.0]])
    inverse_depths = np.array([0.0, 0.0, 1.0, 1.0])
    features = np.concatenate([rays, rays]) + inverse_depths[:, None] * [0.0, 0.0, 1.0]
    seen = _from_anchors(features, view, inverse_depths)
    by_values = by_effects(seen)
    if by_values is None:
        return np.zeros((3, 0))
    directions = directions_by_effects(seen, by_values)
    on_axis, off_axis = directions[2:] - directions[:2]
    along = (on_axis[:1] - off_axis[:1]) / OFF_AXIS
    moved: Array = view.R_wc @ np.concatenate([on_axis, along])
    return moved


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


class TellingWay:
    """Follows whether the way of the camera tells how far its features are.

    Before, position, depth and camera explain the same shifts of the features. The filter, which is linear,
    is too certain of their products; and where the wheels tell noise while the robot does not move, a ceiling
    farther away fits better. So the camera seems to be mounted elsewhere. That lasts where a robot does
    nothing but spin on the spot, and begins again once it has spun until most features are new.
    """

    def __init__(self) -> None:
        self._told: set[int] = set()
        self.tells = False
        """True if the camera has moved enough since it saw most of its features first."""

    def see(self, state: State, view: PosedCamera) -> None:
        """Take one image; one without features of the map changes nothing.

        Args:
            state: after its update.
            view: the camera.
        """
        seen, telling = ids_by_way(state, view.p_wc, MIN_BASELINE)
        if not len(seen):
            return
        self._told.intersection_update(state.landmarks.ids.tolist())
        self._told.update(telling.tolist())
        self.tells = len(self._told.intersection(seen.tolist())) > len(seen) / 2


@compiled
def ids_by_way(state: State, camera_m: Array, least: float) -> tuple[IntArray, IntArray]:
    """Return the ids of the features seen now, and of those since whose first sight the way is long enough.

    Args:
        state: after an image.
        camera_m: (3,) where the camera is.
        least: smallest way, relative to the depth.
    """
    seen = (state.landmarks.last_seen_ns == state.t_ns).nonzero()[0]
    way_m = np.linalg.norm(state.anchors_of(seen).p_wc - camera_m, axis=1)
    ids = state.landmarks.ids[seen]
    return ids, ids[way_m * state.features[seen, 2] > least]


def weighted_scores(stats: UpdateStats, weights: Array) -> UpdateStats:
    """Return the statistics of an update with the scores of the candidates times weights (c,)."""
    if stats.information is None or stats.score is None or min(weights.tolist()) == 1.0:
        return stats
    information, score = scores_weighted(stats.information, stats.score, weights)
    return changed(stats, information=information, score=score)


@compiled
def scores_weighted(information: Array, score: Array, weights: Array) -> tuple[Array, Array]:
    """Return information (c, c) and score (c,) of coefficients times weights (c,)."""
    return information * (weights[:, None] * weights), score * weights


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


def _changed(state: State, model: ImageModel, used: Innovation) -> tuple[IntArray, Array]:
    """Return the indices of the features used whose inverse depth changed, and its changes."""
    seen = used.prediction
    least = MIN_CHANGE * model.config.features.prior_inverse_depth_std
    chosen, change = changed_depths(
        state.mean, state.robot_size, used.rows, seen.scale, seen.points_c, least, MIN_AHEAD
    )
    return used.rows[chosen], change


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
    return change[:, None, None] * across @ view.p_wc_by_pose


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
