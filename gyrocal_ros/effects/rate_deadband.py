"""The sensor reads very small rates as zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place


@dataclass(frozen=True)
class RateDeadband:
    """Rates below `width` are read as zero: the true rate is anywhere in the band.

    As with saturation the width is found in the readings and not estimated.
    """

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'rate_deadband'
    coefficients: tuple[Coefficient, ...] = (Coefficient('width', 'rad/s', prior_std=0.0, prior_mean=0.0),)

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Zero within the band, with the doubt of a uniform distribution over it."""
        rate = block.rate_rad_s[:, 2]
        inside = np.abs(rate) < values[0]
        return GyroTerm(
            np.where(inside, -rate, 0.0),
            np.zeros((len(rate), 1)),
            noise_rad_s=np.where(inside, values[0] / np.sqrt(3.0), 0.0),
            blind=inside,
        )

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Zero within the band."""
        return np.where(np.abs(nominal_rad_s) < values[0], 0.0, nominal_rad_s)
