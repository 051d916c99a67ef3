"""Coefficients that are considered, but not corrected, by an update (Schmidt 1966).

Until the camera has moved, no image tells an effect of camera, wheels or floor from the depths of the
features (`known_depth.has_moved`). The noise of the wheels would nevertheless seem to tell it in spins. So
such a coefficient keeps its value and its standard deviation, and the covariance with it goes on.
"""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import changed
from gyrocal_ros.ekf.effects_by_place import EffectsByPlace
from gyrocal_ros.ekf.state import State


def with_considered_view(before: State, after: State, effects: EffectsByPlace) -> State:
    """Return the state after an update that does not correct effects of camera, wheels and floor.

    Args:
        before: before the update.
        after: after the optimal one.
        effects: effects of the model.
    """
    places = before.coefficient_columns.start + (effects.not_of_view() == 0.0).nonzero()[0]
    if not len(places):
        return after
    mean, covariance, sensitivity = after.mean.copy(), after.covariance.copy(), after.sensitivity.copy()
    block = np.ix_(places, places)
    mean[places], covariance[block] = before.mean[places], before.covariance[block]
    sensitivity[places] = before.sensitivity[places]
    return changed(after, mean=mean, covariance=covariance, sensitivity=sensitivity)
