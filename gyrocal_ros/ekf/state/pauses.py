"""What the state is worth after a time without measurements, and after a new start of the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.ekf.state.layout import POSITION, YAW, YAW_BIAS, State
from gyrocal_ros.model.sensor import SensorModel

GAP_POSITION_STD_M = 0.3
GAP_YAW_STD_RAD = 0.1
"""Standard deviations of the motion during a time without measurements."""


def inflate_after_gap(state: State, t_ns: int) -> State:
    """Carry the robot part of a state without a map over a time without measurements."""
    covariance = state.covariance.copy()
    covariance[POSITION, POSITION] += GAP_POSITION_STD_M**2 * np.eye(3)
    covariance[YAW, YAW] += GAP_YAW_STD_RAD**2
    return replace(state, t_ns=t_ns, covariance=covariance)


def at_own_origin(state: State) -> State:
    """Return a state without a map whose position and heading are exact.

    Nothing but a map gives them a meaning. A camera that is switched on late begins one, and by then the
    unknown scale factor may have made the heading uncertain by whole turns, for which no filter is linear.
    """
    free = [*range(POSITION.start, POSITION.stop), YAW]
    covariance, sensitivity = state.covariance.copy(), state.sensitivity.copy()
    covariance[free] = covariance[:, free] = 0.0
    sensitivity[free] = 0.0
    return replace(state, covariance=covariance, sensitivity=sensitivity)


def drifted(state: State, model: SensorModel, time_s: float, gyro: GyroConfig) -> State:
    """Add the random walks of bias and coefficients over a time that is not predicted."""
    covariance = state.covariance.copy()
    walks = np.array([math.radians(gyro.bias_walk_deg_s), *(item.walk for item in model.coefficients)])
    places = np.arange(YAW_BIAS, state.robot_size)
    covariance[places, places] += walks**2 * time_s
    return replace(state, covariance=covariance)


def restarted_at(start: State, state: State) -> State:
    """Return an initial state near the pose of another one, so that the robot does not jump to the origin.

    Height and tilt start from zero: the new map is as level as the robot is.
    """
    mean = start.mean.copy()
    mean[:2], mean[YAW] = state.mean[:2], state.mean[YAW]
    return inflate_after_gap(replace(start, mean=mean), state.t_ns)
