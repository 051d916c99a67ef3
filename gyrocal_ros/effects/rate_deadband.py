"""The sensor reads very small rates as zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place


@dataclass(frozen=True)
class RateDeadband:
    """Rates below `width` are read as zero: the true rate is anywhere in the band.

    As with saturation the width is found in the readings and not estimated.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='Small readings are set to zero, by friction in the sensing element, by coarse steps '
        'of the converter or by firmware that wants a robot at rest to stand still. Slow turning and '
        'slow drift then go unseen, and so does the bias itself.',
        equation='w_n = 0 where |w_n| < width',
        usual_size='0.05 to 0.5 deg/s',
        best_motion='very slow turns and long gentle arcs to both sides',
        twins=('bias',),
        source='IEEE Std 528, Inertial Sensor Terminology: dead band',
        example=(math.radians(0.3),),
        shown_against='rate',
    )
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
