"""States, steps and derivatives of the filter for tests of its algebra."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from contracts import CAMERA, FEATURES, LATER_POSE, NOISE_PX, PIXELS, view_at

from gyrocal_ros.config.sections import Config, GyroConfig, WheelConfig
from gyrocal_ros.data import Array, IntArray, MotionBlock
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.predict import FilterModel, Transition, predict
from gyrocal_ros.ekf.features.landmarks import augment
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.camera import bearing
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.features.base import Parametrisation
from gyrocal_ros.model.sensor import SensorModel

EFFECTS = tuple(
    map(
        find_effect,
        ('scale_factor', 'scale_cubic', 'bias_warmup', 'turn_slip', 'lateral_drift', 'camera_time_offset'),
    )
)
CANDIDATES = tuple(map(find_effect, ('scale_asymmetry', 'turn_hysteresis', 'wheel_scale', 'principal_point')))
MODEL = SensorModel('test', BiasModel(), EFFECTS)
VALUES = np.array([-0.07, 0.002, 0.01, 300.0, 0.0, 0.01, -0.02, 0.01])
"""Coefficients of the model. The turn slip is zero: its derivative by the turn, times its standard deviation,
is of second order and left out."""
SCALES = np.array([0.01, 0.001, 0.003, 40.0, 0.01, 0.005, 0.005, 0.003])
"""Standard deviations of the coefficients."""
K, C = len(VALUES), 6
INVERSE_DEPTH = PARAMETRISATIONS['inverse_depth']
DIRECTIONS = bearing(CAMERA, PIXELS)
QUIET_GYRO = replace(GyroConfig(), rate_noise_deg_s=0.0, bias_walk_deg_s=0.0, tilt_scale_std=0.0)
QUIET_WHEELS = WheelConfig(0.0, 0.0, 0.0, 0.0)


def some_state(form: Parametrisation = INVERSE_DEPTH, seed: int = 0, t_ns: int = 30_000_000_000) -> State:
    """Return a state in the middle of a run: five features, everything correlated with everything.

    They were seen first in one image, so those with anchors share one.
    """
    rng = np.random.default_rng(seed)
    state = initial_state(MODEL, Config(), None, C)
    mean = np.concatenate([LATER_POSE, [0.001, -0.002, 0.003], VALUES])
    state = replace(state, t_ns=t_ns, mean=mean)
    new = form.initialise(view_at(LATER_POSE), PIXELS, NOISE_PX, FEATURES)
    state = augment(state, np.array([3, 1, 4, 15, 9]), PIXELS, DIRECTIONS, new, None, None)
    scale = np.concatenate([[0.02] * 3, [0.003] * 3, [1e-4] * 3, SCALES])
    scale = np.concatenate([scale, np.full(len(state.mean) - len(scale), 0.02)])
    mixing = scale[:, None] * rng.normal(size=(len(scale), len(scale))) / math.sqrt(len(scale))
    covariance = mixing @ mixing.T + np.diag((0.1 * scale) ** 2)
    return replace(state, covariance=covariance, sensitivity=rng.normal(size=(len(scale), C)))


def step(
    state: State,
    block: MotionBlock,
    gyro: GyroConfig = QUIET_GYRO,
    wheels: WheelConfig = QUIET_WHEELS,
    model: SensorModel = MODEL,
) -> tuple[State, Transition]:
    """Predict over one block."""
    effects = sort_effects(model.effects)
    filter_model = FilterModel(model, effects, gyro, wheels)
    return predict(state, block, filter_model, effects.no_memories())


def dense_transition(state: State, block: MotionBlock) -> Array:
    """Return the transition (n, n) of the whole state over one block."""
    matrix = np.eye(len(state.mean))
    matrix[: state.robot_size, : state.robot_size] = step(state, block)[1].matrix
    return matrix


def derivatives(rows: IntArray, width: int) -> tuple[Array, Array]:
    """Return derivatives of the predictions by the coefficients of the model and of candidates."""
    rng = np.random.default_rng(7)
    return (rng.normal(size=(5, width, K)) / SCALES)[rows], rng.normal(size=(5, width, C))[rows]


def block_diagonal(blocks: Array) -> Array:
    """Return the block-diagonal matrix of `blocks` (m, r, r)."""
    count, width, _ = blocks.shape
    matrix = np.zeros((count, width, count, width))
    matrix[np.arange(count), :, np.arange(count)] = blocks
    return matrix.reshape(count * width, count * width)
