"""Initial state of the filter: the priors, or a calibration from an earlier run."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import Array, seconds
from gyrocal_ros.effects.traits import follows_power_on
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, YAW_BIAS, State, no_landmarks
from gyrocal_ros.model.sensor import SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Result of an earlier run: the yaw bias and some or all coefficients of the model."""

    names: tuple[str, ...]
    """`bias` and coefficient names, as in `SensorModel.coefficient_names`."""
    values: Array
    """(len(names),)"""
    covariance: Array
    """(len(names), len(names))"""
    end_ns: int | None = None
    """Stamp of the last measurement; None where unknown."""
    temperature_c: float = math.nan
    """Temperature of the gyro at that time; NaN where unknown."""


def initial_state(model: SensorModel, config: Config, start: Start | None, candidate_count: int = 0) -> State:
    """Return the state before the first sample: pose zero by definition, all else from the priors.

    Values of an earlier run replace their priors. Its bias is a turn-on quantity and may have changed while
    the robot was off, so the prior variance is added to it; the scale factor changes less from one start to
    the next. What time and temperature change is added by `aged` and `warmed` when they are known. What fades
    after power-on may have faded already.
    """
    coefficients = model.coefficients
    size = COEFFICIENTS_START + len(coefficients)
    mean = np.zeros(size)
    mean[COEFFICIENTS_START:] = [item.prior_mean for item in coefficients]
    std = np.zeros(size)
    std[BIAS] = math.radians(config.gyro.bias_prior_std_deg_s)
    std[COEFFICIENTS_START:] = [item.prior_std for item in coefficients]
    covariance = np.diag(std**2)
    if start is not None:
        known = {'bias': YAW_BIAS}
        known |= {name: COEFFICIENTS_START + i for i, name in enumerate(model.coefficient_names)}
        taken = [i for i, name in enumerate(start.names) if name in known]
        places = [known[start.names[i]] for i in taken]
        bias_variance = covariance[YAW_BIAS, YAW_BIAS]
        mean[places] = start.values[taken]
        covariance[np.ix_(places, places)] = start.covariance[np.ix_(taken, taken)]
        covariance[YAW_BIAS, YAW_BIAS] += bias_variance
        covariance += np.diag(_faded(model, mean)) ** 2
    state = State(0, mean, covariance, len(coefficients), no_landmarks(), np.zeros((size, candidate_count)))
    return state if start is None else _with_scale_change(state, model, config.gyro.scale_turn_on_std)


def _faded(model: SensorModel, mean: Array) -> Array:
    """Return the strengths (n,) of the effects that follow power-on, zero elsewhere in a state (n,)."""
    is_strength = [
        follows_power_on(effect) and item.unit != 's'
        for effect in model.effects
        for item in effect.coefficients
    ]
    faded = np.zeros_like(mean)
    faded[COEFFICIENTS_START:] = np.where(is_strength, mean[COEFFICIENTS_START:], 0.0)
    return faded


def aged(state: State, model: SensorModel, start: Start, gyro: GyroConfig) -> State:
    """Add the random walk of the scale factor between an earlier run and the time of the state."""
    if start.end_ns is None:
        return state
    off_s = abs(seconds(state.t_ns - start.end_ns))
    return _with_scale_change(state, model, gyro.scale_walk * math.sqrt(off_s))


def warmed(state: State, model: SensorModel, start: Start, temperature_c: float, gyro: GyroConfig) -> State:
    """Add the change of the scale factor with the temperature since an earlier run, where both are known."""
    difference_k = temperature_c - start.temperature_c
    if not math.isfinite(difference_k):
        return state
    return _with_scale_change(state, model, gyro.scale_temperature_std * difference_k)


def _with_scale_change(state: State, model: SensorModel, std: float) -> State:
    """Add a random change of the scale factor; it is never known worse than by its prior."""
    covariance = state.covariance.copy()
    variance = float(covariance[COEFFICIENTS_START, COEFFICIENTS_START])
    prior = model.coefficients[0].prior_std ** 2
    covariance[COEFFICIENTS_START, COEFFICIENTS_START] = max(variance, min(variance + std**2, prior))
    return replace(state, covariance=covariance)
