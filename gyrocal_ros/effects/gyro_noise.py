"""The gyro has more white noise than its data sheet says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange

_DENSITIES = tuple(np.radians(np.geomspace(0.005, 5.0, 31)).tolist())


@dataclass(frozen=True)
class GyroNoise:
    """White noise of `density` beside that of the settings."""

    about: ClassVar[Explanation] = Explanation(
        physics='The readings scatter more than the settings say, at any rate. Nothing can correct that, but '
        'the filter has to know it: with too little noise it trusts the gyro too much, and its standard '
        'deviations are too small.',
        equation='w = w_n + noise of this density',
        usual_size='0.005 to 0.1 deg/s/sqrt(Hz)',
        best_motion='any motion, seen by the camera',
        source='IEEE Std 952-1997, annex C: angle random walk',
        example=(math.radians(0.05),),
    )
    acts_on: ClassVar[Place] = 'noise'
    name: str = 'gyro_noise'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'density',
            'rad/s/sqrt(Hz)',
            prior_std=0.0,
            scan=_DENSITIES,
            typical=TypicalRange(math.radians(0.03), math.radians(0.15), signed=False),
        ),
    )

    def density(self, rate_rad_s: Array, values: Array) -> Array:
        """Return the density of the white noise (N,), rad/s/sqrt(Hz)."""
        return np.full(len(rate_rad_s), values[0])

    def bias_walk(self, values: Array) -> float:
        """Return the random walk of the bias: none."""
        return 0.0
