"""The noise of the gyro grows with the rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange

_PARTS = tuple(np.geomspace(1e-4, 0.1, 31).tolist())


@dataclass(frozen=True)
class RateNoise:
    """White noise of density `k |w_n|` beside that of the settings."""

    about: ClassVar[Explanation] = Explanation(
        physics='The readings scatter more while the robot turns, and more the faster it turns: noise of the '
        'supply or of the drive acts on the scale factor. The mean is right, so nothing can correct that, '
        'but the filter has to know it.',
        equation='w = w_n + noise of density k |w_n|',
        usual_size='k = 0.0005 to 0.01 sqrt(s)',
        best_motion='turns at several speeds',
        source='IEEE Std 1431-2004, Coriolis vibratory gyros: noise that depends on the rate',
        example=(0.002,),
    )
    acts_on: ClassVar[Place] = 'noise'
    name: str = 'rate_noise'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'k', 'sqrt(s)', prior_std=0.0, scan=_PARTS, typical=TypicalRange(0.0015, 0.006, signed=False)
        ),
    )

    def density(self, rate_rad_s: Array, values: Array) -> Array:
        """Return the density of the white noise (N,), rad/s/sqrt(Hz)."""
        density: Array = values[0] * np.abs(rate_rad_s)
        return density

    def bias_walk(self, values: Array) -> float:
        """Return the random walk of the bias: none."""
        return 0.0
