"""Coefficients that are considered, but not corrected, by an update (Schmidt 1966).

Until the camera has moved, no image tells an effect of camera, wheels or floor from the depths of the
features (`known_depth.TellingWay`), but for a rotation of the camera. The noise of the wheels would
nevertheless seem to tell it in spins.

A delay from row to row hardly shifts features while the robot drives straight on, and what it does looks like
other depths. Slow errors of the tracks would seem to tell it.

An effect of the floor that lengthens the way of the robot looks like another size of the map, for as long as
the robot drives one way. The depths are known less well than their product with the way, and each correction
of them would seem to tell the length. What carries the robot across its way, images tell at once.

So such a coefficient, or combination of them, keeps its value and its standard deviation, and the covariance
with it goes on. So do the position and the depths while the robot stays: images from one place tell nothing
of either, but each that is not quite consistent with the first would seem to.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array, IntArray, changed
from gyrocal_ros.ekf.features.image_model import ImageModel
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, POSITION, State

MIN_STRETCH_STD = 0.001
"""Standard deviation of a stretch of the way, relative to it, from which the map may be of another size."""


def with_considered(before: State, after: State, combinations: Array) -> State:
    """Return the state after an update that does not correct combinations of coefficients.

    What is independent of them is corrected as by the optimal gain.

    Args:
        before: before the update.
        after: after the optimal one.
        combinations: C (q, k) weights of the coefficients in each.
    """
    if not len(combinations):
        return after
    C, k = combinations, before.coefficient_columns
    P, P_after = before.covariance[k, k], after.covariance[k, k]
    own = C @ P @ C.T
    by_combinations = P @ C.T @ np.linalg.pinv(own)
    mean, covariance, sensitivity = after.mean.copy(), after.covariance.copy(), after.sensitivity.copy()
    mean[k] -= by_combinations @ C @ (after.mean[k] - before.mean[k])
    covariance[k, k] += by_combinations @ (own - C @ P_after @ C.T) @ by_combinations.T
    sensitivity[k] -= by_combinations @ C @ (after.sensitivity[k] - before.sensitivity[k])
    return changed(after, mean=mean, covariance=covariance, sensitivity=sensitivity)


def with_kept(before: State, after: State, places: IntArray) -> State:
    """Return the state after an update that does not correct what is at some places (p,) of the state.

    Args:
        before: before the update.
        after: after the optimal one.
        places: indices of the state.
    """
    mean, covariance, sensitivity = after.mean.copy(), after.covariance.copy(), after.sensitivity.copy()
    mean[places], sensitivity[places] = before.mean[places], before.sensitivity[places]
    square = np.ix_(places, places)
    covariance[square] = before.covariance[square]
    return changed(after, mean=mean, covariance=covariance, sensitivity=sensitivity)


def not_told_at_rest(state: State, model: ImageModel) -> IntArray:
    """Return the places of position, coefficients that images at rest do not show, depths and anchors."""
    depths = np.arange(state.robot_size + 2, state.anchors_start, 3)
    coefficients = COEFFICIENTS_START + (model.effects.shown(moves=False, turns=False) == 0.0).nonzero()[0]
    anchors = np.arange(state.anchors_start, len(state.mean))
    return np.concatenate([np.arange(POSITION.stop), coefficients, depths, anchors])


def wait_for_motion(model: ImageModel) -> bool:
    """Return True while coefficients keep their values until the camera has moved."""
    return not model.has_moved and model.effects.act_on_view and bool(_is_not_told(model).any())


def combinations_not_told(state: State, model: ImageModel) -> Array:
    """Return the combinations (q, k) of the coefficients that an image cannot tell."""
    effects, stretch, k = model.effects, model.stretch_by_values, state.coefficient_columns
    if not effects.act_on_view:  # always shown
        return np.empty((0, effects.count))
    not_told = np.eye(effects.count)[_is_not_told(model)]
    if not model.has_moved or stretch is None:
        return not_told
    variance = float(stretch @ state.covariance[k, k] @ stretch)
    if variance < MIN_STRETCH_STD**2:
        return not_told
    return np.concatenate([not_told, stretch[None]])


def _is_not_told(model: ImageModel) -> np.ndarray:
    """Return which coefficients (k,) an image cannot tell by itself."""
    return model.effects.shown(moves=model.has_moved, turns=model.turns) == 0.0


def stretch_by_values(way_m: Array, drift_by_values: Array) -> Array | None:
    """Return by how much coefficients lengthen the way over a block, relative to it, as derivatives (k,).

    Args:
        way_m: (3,) by the wheels.
        drift_by_values: (3, k) derivative of the displacement that no sensor measures.

    Returns:
        (k,) or None for a robot that stays where it is.
    """
    square_m2 = float(way_m @ way_m)
    return way_m @ drift_by_values / square_m2 if square_m2 > 0.0 else None
