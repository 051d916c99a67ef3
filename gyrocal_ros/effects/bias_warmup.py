"""The bias settles after power-on, as the part warms itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.gyro import Coefficient


@dataclass(frozen=True)
class BiasWarmup:
    """`-C exp(-t / tau)`: with the bias it makes B + C (1 - exp(-t / tau)) - C.

    The reference is long after power-on, so the term vanishes there and the bias keeps its meaning.
    Time counts from the first IMU sample.
    """

    name: str = 'bias_warmup'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('amplitude', 'rad/s', prior_std=math.radians(1.0)),
        Coefficient('time_constant', 's', prior_std=200.0, prior_mean=500.0),
    )

    def correction(self, block: MotionBlock, values: Array) -> Array:
        """(N,) rad/s."""
        amplitude, time_constant = values
        return -amplitude * np.exp(-block.time_s / _at_least_a_second(time_constant))

    def jacobian(self, block: MotionBlock, values: Array) -> Array:
        """(N, 2)"""
        amplitude, time_constant = values
        time_constant = _at_least_a_second(time_constant)
        decay = np.exp(-block.time_s / time_constant)
        return np.stack([-decay, -amplitude * decay * block.time_s / time_constant**2], axis=1)


def _at_least_a_second(time_constant: float) -> float:
    """Keep the estimate of the time constant where the exponential means something."""
    return max(float(time_constant), 1.0)
