"""The way that the wheels really tell: none where their noise explains what they measure.

A robot that turns on the spot does not move, and its wheels tell noise. That noise is in the predicted
position, so the images contradict it. Where it is in a derivative, too, the update regresses the
contradiction on its own cause (errors in variables, see `ekf.equations.steady_rate`): each image of a robot
that only spins makes all depths larger, by the square of their relative standard deviation, and its wheels
seem to have no scale. So the derivatives are taken without such a way.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import WheelConfig
from gyrocal_ros.data import Array, IntArray, MotionBlock, changed
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.model.features.base import PosedCamera, Prediction

NOISE_SIGMA = 5.0
"""Way of a block, in standard deviations by the settings, up to which it may be noise. Wheels are often two
to three times as noisy as set."""
KNOWN_DEPTH = 0.1
"""Relative standard deviation of a known depth. By an unknown one, the derivative has to be that at the
predicted position: the depth may change so far that another one would be off by many pixels."""


def is_certain(block: MotionBlock, wheels: WheelConfig) -> bool:
    """Return True if the wheels stand still, or their noise does not explain the way of a block."""
    way_m, turn_rad, *_ = block.way_and_turn()
    variance_m2 = wheels.distance_noise_m**2 * abs(way_m) + wheels.turn_noise_m**2 * abs(turn_rad)
    return way_m == 0.0 or abs(way_m) > NOISE_SIGMA * math.sqrt(variance_m2)


def without_way(block: MotionBlock) -> MotionBlock:
    """Return the block of a robot that stays where it is."""
    return changed(block, distance_m=np.zeros(len(block.dt_s)))


def at_certain_way(
    state: State, view: PosedCamera, rows: IntArray, prediction: Prediction, noise_m: Array
) -> Prediction:
    """Return a prediction with derivatives by known depths as if the noise of the wheels had moved nothing.

    Args:
        state: predicted.
        view: the camera.
        rows: (m,) indices of the features in the map.
        prediction: of features by direction and inverse depth.
        noise_m: (3,) displacement since the last image that may be noise of the wheels.
    """
    places = state.robot_size + 3 * rows + 2
    are_known = np.sqrt(state.covariance[places, places]) < KNOWN_DEPTH * np.abs(state.mean[places])
    by_feature = prediction.by_feature.copy()
    by_feature[:, :, 2] += are_known[:, None] * (prediction.by_point @ (view.R_wc.T @ noise_m))
    return changed(prediction, by_feature=by_feature)
