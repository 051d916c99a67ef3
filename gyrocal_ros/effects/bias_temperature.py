"""The bias follows the temperature of the part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column, recorded
from gyrocal_ros.model.sensor import Coefficient, TypicalRange

REFERENCE_C = 25.0


@dataclass(frozen=True)
class BiasTemperature(LinearGyroEffect):
    """`k (T - T0)`, T0 = 25 deg C."""

    about: ClassVar[Explanation] = Explanation(
        physics='Warmth changes the stiffness and the tension of the vibrating structure and the '
        'offsets of the amplifiers behind it, so what the sensor reads at rest follows its '
        'temperature. Motors, charging or a warm room are enough. The bias refers to 25 deg C.',
        equation='w = w_n + k (T - 25 deg C)',
        usual_size='0.005 to 0.05 deg/s/K',
        best_motion='rests at several temperatures, best while warming up and again while cooling down',
        twins=('bias_warmup', 'covariate_bias'),
        needs=('temperature',),
        source='Aggarwal, Syed, Niu, El-Sheimy 2008, A standard testing and calibration procedure for '
        'low cost MEMS inertial sensors and units, Journal of Navigation 61(2)',
        example=(math.radians(0.02),),
        shown_against='temperature',
    )
    name: str = 'bias_temperature'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'k',
            'rad/s/K',
            prior_std=math.radians(0.05),
            typical=TypicalRange(math.radians(0.01), math.radians(0.05)),
        ),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(recorded(block.temperature_c - REFERENCE_C))
