"""The bias wanders or jumps by chance more than its data sheet says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange

_WALKS = tuple(np.radians(np.geomspace(5e-4, 0.5, 31)).tolist())


@dataclass(frozen=True)
class BiasInstability:
    """A random walk of the bias beside that of the settings."""

    about: ClassVar[Explanation] = Explanation(
        physics='The bias wanders without a cause that is recorded, or jumps to and fro between levels '
        '(popcorn noise). Nothing predicts it, but the filter has to know it: then it follows faster, and '
        'its standard deviations are right.',
        equation='db/dt = noise of density walk',
        usual_size='0.0005 to 0.02 deg/s/sqrt(s)',
        best_motion='rests of different lengths between drives',
        source='IEEE Std 952-1997, annex C: rate random walk',
        example=(math.radians(0.01),),
    )
    acts_on: ClassVar[Place] = 'noise'
    name: str = 'bias_instability'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'walk',
            'rad/s/sqrt(s)',
            prior_std=0.0,
            scan=_WALKS,
            typical=TypicalRange(math.radians(0.003), math.radians(0.02), signed=False),
        ),
    )

    def density(self, rate_rad_s: Array, values: Array) -> Array:
        """Return the density of the white noise (N,): none."""
        return np.zeros(len(rate_rad_s))

    def bias_walk(self, values: Array) -> float:
        """Return the random walk of the bias, rad/s/sqrt(s)."""
        return float(values[0])
