"""Prediction: state and covariance over one block of IMU and wheel samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from gyrocal_ros.config.sections import GyroConfig, WheelConfig
from gyrocal_ros.data import Array, MotionBlock, changed, quickly_filled
from gyrocal_ros.ekf.equations.effects_by_place import (
    EffectsByPlace,
    MotionContribution,
    contribute,
    pose_by_lacking,
    pose_by_values,
)
from gyrocal_ros.ekf.noise.process_noise import BlockNoise, process_noise, yaw_noise
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, EULER, POSE, POSITION, YAW, YAW_BIAS, State
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.gyro import body_rates, correct
from gyrocal_ros.model.kinematics import PoseStep, integrate
from gyrocal_ros.model.sensor import Memory, SensorModel

UNMEASURED_SPEED_M_S = 0.5
"""Standard deviation of the speed while the wheel encoders send nothing."""
MISALIGNMENT_RAD = 0.003
"""Standard deviation of the angle between camera and x and y gyros. In a turn, these miss that part of the
yaw rate, which looks like a bias while the rate lasts. Taken for one that stays, it would tilt the robot for
long after the turn."""
SLOW_TILT_RAD_S = math.radians(1.0)
"""Rate of a tilt, as on any floor, of which the x and y gyros miss less than their noise."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class FilterModel:
    """Process model of the filter: the sensor model and the noise of gyro and wheels."""

    sensors: SensorModel
    effects: EffectsByPlace
    """Effects of the sensor model, by place."""
    gyro: GyroConfig
    wheels: WheelConfig
    tilt_rate_noise_rad_s: Sequence[float] | None = None
    """(2,) white noise densities of the x and y gyros; None where they are like the yaw gyro's."""
    rate_change_rad_s: float = 0.0
    """Change of the yaw rate since the last block, see `MISALIGNMENT_RAD`."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """Change of the robot part of the state (r = 9 + k) over one block."""

    matrix: Array
    """(r, r)"""
    motion: PoseStep
    contribution: MotionContribution
    """Contribution of the effects of the model."""
    rate_rad_s: Array
    """(N, 3) corrected body rates."""
    yaw_gain: Array
    """(6, N) d pose / d correction of the yaw rate of each interval; zero without a valid reading."""


def with_pose(block: MotionBlock, state: State) -> MotionBlock:
    """Return the block with the bias, and heading and position in the middle of each interval, for effects.

    They are those of the state; heading and position are continued by the nominal rate and the wheels.
    """
    heading_rad, position_m = path_in_block(state.mean, block.rate_rad_s, block.dt_s, block.distance_m)
    bias_rad_s = float(state.mean[YAW_BIAS])
    return changed(block, heading_rad=heading_rad, position_m=position_m, bias_rad_s=bias_rad_s)


@compiled
def path_in_block(mean: Array, rate_rad_s: Array, dt_s: Array, distance_m: Array) -> tuple[Array, Array]:
    """Return heading (N,) and position (N, 2) in the middle of N intervals.

    Args:
        mean: of the state at the start.
        rate_rad_s: (N, 3)
        dt_s: (N,)
        distance_m: (N,)
    """
    turn_rad = rate_rad_s[:, 2] * dt_s
    heading_rad = mean[YAW] + turn_rad.cumsum() - 0.5 * turn_rad
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)]).T * distance_m[:, None]
    return heading_rad, mean[:2] + ahead.cumsum(axis=0) - 0.5 * ahead


def predict(
    state: State,
    block: MotionBlock,
    model: FilterModel,
    memories: Sequence[Memory],
    steady: MotionBlock | None = None,
) -> tuple[State, Transition]:
    """Eq. (10): robot, bias and coefficients over one block; Eq. (11): features do not move.

    Args:
        state: at the start of the block.
        block: samples up to its end.
        model: sensor model and noise.
        memories: memories of the gyro effects.
        steady: the block with the rate and the way at which the effects are differentiated, see
            `ekf.equations.steady_rate` and `ekf.features.certain_way`; None for the block itself.
    """
    correction = correct(model.effects.gyro, block, state.coefficients, memories)
    rate = body_rates(block, correction, state.bias_rad_s)
    added = contribute(model.effects, block, correction, rate, state.coefficients)
    bias, bias_kept = model.sensors.bias.step(state.bias_rad_s[2], block.duration_s)
    mean, covariance, sensitivity, matrix, yaw_gain, *motion = carry(
        state,
        block,
        rate,
        _differentiated(added, block, steady, model, state, memories, rate),
        _noise_of(block, model, rate, correction.unread_rad(block.dt_s)),
        bias,
        bias_kept,
    )
    after = changed(state, t_ns=block.end_ns, mean=mean, covariance=covariance, sensitivity=sensitivity)
    return after, Transition(matrix, PoseStep(*motion), added, rate, yaw_gain)


@compiled
def carry(
    state: State,
    block: MotionBlock,
    rate_rad_s: Array,
    added: MotionContribution,
    noise: BlockNoise,
    bias_rad_s: float,
    bias_kept: float,
) -> tuple[Array, ...]:
    """Carry mean and covariance over one block of N intervals.

    Args:
        state: at the start of the block.
        block: samples up to its end.
        rate_rad_s: (N, 3) corrected body rates.
        added: contribution of the effects, with derivatives at the steady rate.
        noise: of the block.
        bias_rad_s: yaw bias at the end.
        bias_kept: factor by which it decays.

    Returns:
        Mean (n,), covariance (n, n) and sensitivity (n, c) at the end of the block; the transition (r, r) of
        the robot part; (6, N) d pose / d correction of the yaw rate; the fields of the `PoseStep`.
    """
    distance_m = block.distance_m + added.distance_m
    motion = integrate(state.position_m, state.euler_rad, rate_rad_s, block.dt_s, distance_m)
    yaw_gain = motion.rate_gain[:, 2] * added.correction.valid
    by_values = pose_by_values(motion, yaw_gain, added)
    matrix = transition_matrix(motion, yaw_gain, by_values, bias_kept)
    covariance = process_noise(
        noise,
        motion.rate_gain,
        motion.mid_euler_rad,
        block.dt_s,
        block.rate_rad_s[:, 2],
        block.distance_m,
    )
    mean = state.mean.copy()
    mean[POSITION], mean[EULER] = motion.position_m + added.drift_m, motion.euler_rad
    mean[YAW_BIAS] = bias_rad_s
    carried = carry_covariance(state.covariance, state.sensitivity, matrix, covariance)
    step = (getattr(motion, item.name) for item in fields(motion))
    return mean, *carried, matrix, yaw_gain, *step


def _differentiated(
    added: MotionContribution,
    block: MotionBlock,
    steady: MotionBlock | None,
    model: FilterModel,
    state: State,
    memories: Sequence[Memory],
    rate_rad_s: Array,
) -> MotionContribution:
    """Return the contributions of a block with derivatives at the steady rate and the certain way."""
    if steady is None or steady is block:
        return added
    at_steady = contribute(
        model.effects,
        steady,
        correct(model.effects.gyro, steady, state.coefficients, memories),
        rate_rad_s,
        state.coefficients,
    )
    return changed(
        added,
        correction=changed(added.correction, by_values=at_steady.correction.by_values),
        distance_by_values=at_steady.distance_by_values,
        drift_by_values=at_steady.drift_by_values,
    )


def transition_matrix(motion: PoseStep, yaw_gain: Array, by_values: Array, bias_kept: float) -> Array:
    """Return the transition (r, r) of the robot part of the state over a block of N intervals.

    Args:
        motion: in the block.
        yaw_gain: (6, N) d pose / d correction of the yaw rate of each interval.
        by_values: (6, k) d pose / d coefficients.
        bias_kept: factor by which the yaw bias decays.
    """
    matrix = np.eye(COEFFICIENTS_START + by_values.shape[1])
    matrix[POSE, POSE] = motion.transition
    matrix[POSE, BIAS] = motion.rate_gain.sum(axis=2)
    matrix[POSE, YAW_BIAS] = yaw_gain.sum(axis=1)
    matrix[POSE, COEFFICIENTS_START:] = by_values
    matrix[YAW_BIAS, YAW_BIAS] = bias_kept
    return matrix


def carry_covariance(
    covariance: Array, sensitivity: Array, matrix: Array, noise: Array
) -> tuple[Array, Array]:
    """Return the covariance P (n, n) and F X (n, c) after one block: the features do not move.

    Args:
        covariance: before, (n, n).
        sensitivity: X before, (n, c).
        matrix: (r, r) transition of the robot part.
        noise: (r, r) covariance that the block adds.
    """
    r = len(matrix)
    after = np.empty_like(covariance)
    after[:r, :r] = matrix @ covariance[:r, :r] @ matrix.T + noise
    after[:r, r:] = matrix @ covariance[:r, r:]
    after[r:, :r] = after[:r, r:].T
    after[r:, r:] = covariance[r:, r:]
    carried = sensitivity.copy()
    carried[:r] = matrix @ sensitivity[:r]
    return after, carried


def predict_sensitivity(
    state: State,
    transition: Transition,
    block: MotionBlock,
    candidates: EffectsByPlace,
    memories: Sequence[Memory],
) -> tuple[State, tuple[Memory, ...]]:
    """Predict the sensitivity to effects that the model lacks: `X(k+1) = F X(k) + df / dtheta`.

    After Friedland 1969. The candidates' own coefficients stay at their prior means.

    Args:
        state: already predicted, with F X as its sensitivity.
        transition: transition of that prediction.
        block: the block, with the rate and the way at which effects are differentiated.
        candidates: effects that the model lacks.
        memories: their memories.

    Returns:
        The state with its sensitivity predicted, and the new memories.
    """
    if not candidates.act_on_motion:
        return state, tuple(memories)
    by_values, kept = pose_by_lacking(
        candidates, block, transition.motion, transition.yaw_gain, transition.rate_rad_s, memories
    )
    sensitivity = state.sensitivity.copy()
    sensitivity[POSE] += by_values
    return changed(state, sensitivity=sensitivity), kept


def _noise_of(block: MotionBlock, model: FilterModel, rate_rad_s: Array, unknown_rad: float) -> BlockNoise:
    """Return the noise of a block.

    Args:
        block: of N intervals.
        model: noise and effects.
        rate_rad_s: (N, 3) corrected body rates.
        unknown_rad: standard deviation of the turn that the gyro could not read.
    """
    gyro, wheels, effects = model.gyro, model.wheels, model.effects
    density, walk = math.radians(gyro.rate_noise_deg_s), math.radians(gyro.bias_walk_deg_s)
    yaw_density: Array | float = density
    yaw_walk, walks = walk, effects.walks
    if effects.noise:
        yaw = yaw_noise(effects.noise, effects.prior_means, gyro, block.rate_rad_s[:, 2])
        yaw_density, yaw_walk = yaw.density_rad_s, yaw.bias_walk_rad_s
    if effects.count and gyro.scale_walk:  # the first coefficient is the scale factor
        walks = walks.copy()
        walks[0] = math.hypot(walks[0], gyro.scale_walk)
    duration_s = block.duration_s
    tilt_walk = math.hypot(walk, MISALIGNMENT_RAD * model.rate_change_rad_s / math.sqrt(duration_s))
    slow_rad, per_rad = SLOW_TILT_RAD_S * duration_s, gyro.tilt_scale_std / math.sqrt(duration_s)
    tilts_rad = block.dt_s.dot(rate_rad_s)[:2].tolist()
    missed = (per_rad * max(abs(tilt_rad) - slow_rad, 0.0) for tilt_rad in tilts_rad)
    by_readings = (density, density) if model.tilt_rate_noise_rad_s is None else model.tilt_rate_noise_rad_s
    return BlockNoise(
        np.array([*map(math.hypot, by_readings, missed)]),
        yaw_density,
        math.radians(gyro.gap_rate_std_deg_s) * block.gap_s,
        unknown_rad,
        (wheels.distance_noise_m, wheels.lateral_noise_m, wheels.vertical_noise_m, wheels.turn_noise_m),
        UNMEASURED_SPEED_M_S * block.wheel_gap_s,
        tilt_walk,
        yaw_walk,
        walks,
        duration_s,
    )
