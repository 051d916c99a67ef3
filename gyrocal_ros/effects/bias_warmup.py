"""The bias settles after power-on, as the part warms itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place

MIN_TIME_CONSTANT_S = 1.0


@dataclass(frozen=True)
class BiasWarmup:
    """`-C exp(-t / tau)`: with the bias it makes B + C (1 - exp(-t / tau)) - C.

    The reference is long after power-on, so the term vanishes there and the bias keeps its meaning.
    Time counts from the first IMU sample.
    """

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'bias_warmup'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('amplitude', 'rad/s', prior_std=math.radians(1.0)),
        Coefficient('time_constant', 's', prior_std=200.0, prior_mean=300.0),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Contribution and its derivative (N, 2)."""
        amplitude, time_constant = values[0], max(values[1], MIN_TIME_CONSTANT_S)
        decay = np.exp(-block.time_s / time_constant)
        by_time_constant = -amplitude * decay * block.time_s / time_constant**2
        return GyroTerm(-amplitude * decay, np.stack([-decay, by_time_constant], axis=1))
