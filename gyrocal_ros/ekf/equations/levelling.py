"""Levelling: gravity bounds roll and pitch where no camera does.

The gyros about x and y are integrated to roll and pitch, whose error grows with their noise; a wrong tilt
turns the yaw axis away from the vertical. The accelerometer shows the vertical, disturbed by the
accelerations of the robot.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import STANDARD_GRAVITY_M_S2, Array, MotionBlock
from gyrocal_ros.ekf.equations.update import tilt_update
from gyrocal_ros.ekf.state.layout import EULER, YAW_BIAS, State

INITIAL_STD_RAD = math.radians(5.0)
"""Prior standard deviation of roll and pitch."""
REST_NOISE_M_S2 = 0.2
"""Standard deviation of the specific force beside gravity on a straight line: bias, uneven floor."""
UNMEASURED_SPEED_M_S, MEASURED_SPEED_M_S = 2.0, 0.2
"""Standard deviations of the speed that the centripetal acceleration has, without and with wheel odometry."""
CORRELATION_S = 1.0
"""Time for which an acceleration of the robot lasts."""
NOISE_S = 20.0
"""Time constant of the estimate of the gyro noise."""


class Levelling:
    """Noise of the x and y gyros, and updates of roll and pitch by gravity."""

    def __init__(self) -> None:
        self._noise: Array = np.zeros(2)
        self._observed_s = 0.0
        self._last_rate: Array | None = None

    def rate_noise_rad_s(self, block: MotionBlock) -> Array:
        """Return white noise densities (2,) of the x and y gyros, from the changes between samples.

        The readings of a block are means of two samples, so white noise of density q changes them over two
        intervals by q^2 / (2 dt).
        """
        rates = block.rate_rad_s[:, :2]
        if self._last_rate is not None:
            rates = np.concatenate([self._last_rate[None], rates])
        if len(rates) > 1:
            duration_s = block.duration_s
            density = 2.0 * np.mean(np.diff(rates, axis=0) ** 2, axis=0) * (duration_s / len(block.dt_s))
            self._observed_s += duration_s
            share = min(1.0, duration_s / min(self._observed_s, NOISE_S))
            self._noise = self._noise + share * (density - self._noise)
        self._last_rate = rates[-1]
        return np.sqrt(self._noise)

    def update(self, state: State, block: MotionBlock) -> State:
        """Correct roll and pitch by the mean specific force of a block.

        Without readings about x and y (a gyro with one axis) the tilt cannot be followed, and is left.
        """
        duration_s = block.duration_s
        force = block.dt_s @ block.specific_force_m_s2 / duration_s
        if force[2] < 0.0:
            force = -force  # a driver that publishes gravity in place of the specific force
        size = float(np.linalg.norm(force))
        if not block.rate_rad_s[:, :2].any() or size < 0.5 * STANDARD_GRAVITY_M_S2:
            return state
        yaw_rate = float(block.dt_s @ block.rate_rad_s[:, 2]) / duration_s + float(state.mean[YAW_BIAS])
        has_wheels = block.wheel_gap_s == 0.0
        if has_wheels:
            force[1] -= yaw_rate * float(block.distance_m.sum()) / duration_s
        speed = MEASURED_SPEED_M_S if has_wheels else UNMEASURED_SPEED_M_S
        disturbance = math.hypot(REST_NOISE_M_S2, speed * yaw_rate, size - STANDARD_GRAVITY_M_S2)
        std_rad = disturbance / STANDARD_GRAVITY_M_S2 * math.sqrt(max(CORRELATION_S / duration_s, 1.0))
        roll_rad = math.atan2(force[1], force[2])
        pitch_rad = math.atan2(-force[0], math.hypot(force[1], force[2]))
        return tilt_update(state, np.array([roll_rad, pitch_rad]), np.full(2, std_rad))


def unlevelled(state: State) -> State:
    """Return an initial state whose roll and pitch are unknown."""
    covariance = state.covariance.copy()
    tilt = [EULER.start, EULER.start + 1]
    covariance[tilt, tilt] += INITIAL_STD_RAD**2
    return State(
        state.t_ns, state.mean, covariance, state.coefficient_count, state.landmarks, state.sensitivity
    )
