"""Anchors of features: the places from which the camera saw them first.

The position of an anchor is a state, for it errs with the robot at the first sight. Were it a constant, the
direction of the feature would err instead, by the error of the position times the inverse depth. At the first
sight the depth is a guess, and each image that corrects it would seem to tell where the robot is: positions,
the size of the map and effects of the camera would become certain without reason (Julier and Uhlmann 2001, A
counter example to the theory of simultaneous localization and map building).

An effect that moves the camera on the robot moves all anchors with it. They keep their derivative by its
coefficients, so that an image tells of them only where the robot has turned since.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import IntArray, changed
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.features.known_depth import camera_by_effects
from gyrocal_ros.ekf.features.landmarks import with_entries, with_shared_errors
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.features.base import NewFeatures

KNOWN_DEPTH = 0.005
"""Relative standard deviation of an inverse depth from which its anchor need not be estimated."""


def with_moving_anchors(state: State, model: ImageModel, first: NewFeatures) -> NewFeatures:
    """Return new features whose anchors move with the coefficients of model and candidates."""
    count = len(first.parameters)
    by_values = camera_by_effects(model.view, lambda seen: model.by_values(seen, state.coefficients))
    by_candidates = camera_by_effects(model.view, model.by_candidates)
    anchors = changed(
        first.anchors,
        by_values=np.tile(by_values, (count, 1, 1)),
        by_candidates=np.tile(by_candidates, (count, 1, 1)),
    )
    return changed(first, anchors=anchors)


def with_moved_anchors(before: State, after: State) -> State:
    """Move the anchors with the camera on the robot, as an update has corrected the coefficients."""
    landmarks = after.landmarks
    by_values = landmarks.anchors.by_values
    if not by_values.shape[2] or not len(landmarks.ids):
        return after
    mean, columns = after.mean.copy(), after.anchor_columns(np.arange(len(landmarks.ids)))
    _, first = np.unique(columns, return_index=True)
    places = columns[first, None] + np.arange(3)
    mean[places] += by_values[first] @ (after.coefficients - before.coefficients)
    return changed(after, mean=mean)


def settled(state: State) -> State:
    """Take anchors as constants where the depth of a feature is known: fewer states make a step faster."""
    if not state.has_anchors:
        return state
    known = known_anchored(state, KNOWN_DEPTH)
    return with_constant_anchors(state, known) if len(known) else state


@compiled
def known_anchored(state: State, known: float) -> IntArray:
    """Return the features, as indices, whose anchor is a state and whose depth is known.

    Args:
        state: after an update.
        known: relative standard deviation of a known depth.
    """
    rows = (state.landmarks.anchor_rows >= 0).nonzero()[0]
    depths = state.robot_size + 3 * rows + 2
    stds = np.sqrt(state.covariance.diagonal()[depths])
    return rows[stds < known * np.abs(state.mean[depths])]


def with_constant_anchors(state: State, rows: IntArray) -> State:
    """Take the anchors of features (f,), which are in the state, as constants.

    The features share their errors instead, by the depths that they have now. No effect of the model may move
    the camera; candidates may.
    """
    anchors, columns = state.anchors_of(rows), state.anchor_columns(rows)
    features, causes = state.features[rows], np.unique(columns)
    R_aw, inverse_depths = anchors.R_wc.transpose(0, 2, 1), features[:, 2, None, None]
    by_anchor = inverse_depths * R_aw
    by_anchor[:, :2] -= features[:, :2, None] * by_anchor[:, 2:]
    by_anchor[:, 2:] *= -inverse_depths
    by_causes = by_anchor[:, :, None, :] * (columns[:, None] == causes)[:, None, :, None]
    places = state.feature_columns(rows).ravel()
    state = with_shared_errors(
        state, places, (causes[:, None] + np.arange(3)).ravel(), by_causes.reshape(len(places), -1)
    )
    landmarks = state.landmarks
    p_wc, anchor_rows = landmarks.anchors.p_wc.copy(), landmarks.anchor_rows.copy()
    p_wc[rows], anchor_rows[rows] = anchors.p_wc, -1
    constant = changed(landmarks.anchors, p_wc=p_wc)
    if constant.by_candidates.shape[2]:
        sensitivity, by_candidates = state.sensitivity.copy(), constant.by_candidates.copy()
        sensitivity[places] += (by_anchor @ by_candidates[rows]).reshape(len(places), -1)
        by_candidates[rows] = 0.0
        state, constant = (
            changed(state, sensitivity=sensitivity),
            changed(constant, by_candidates=by_candidates),
        )
    landmarks = changed(landmarks, anchors=constant, anchor_rows=anchor_rows)
    return with_entries(state, np.ones(3 * len(anchor_rows), bool), landmarks)
