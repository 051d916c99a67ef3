"""Vibration that is symmetric in force gives a rate with a nonzero mean."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class VibrationRectification(LinearGyroEffect):
    """`k var(a)`, with the recent variance of the specific force, all axes together."""

    about: ClassVar[Explanation] = Explanation(
        physics='Shaking back and forth should average out. Where the structure responds differently to '
        'the two directions, a part of it remains as a steady false rate that grows with the '
        'strength of the shaking. It comes and goes with the fan, the brush and the floor.',
        equation='w = w_n + k var(a)',
        usual_size='0.01 to 0.1 deg/s in all',
        best_motion='rests with fan and brush off, on, and at full power; rough and smooth floors',
        twins=('covariate_bias', 'scale_asymmetry'),
        source='Weinberg 2011, Gyro mechanical performance: the most important parameter, Analog '
        'Devices MS-2158',
        example=(math.radians(0.5),),
        shown_against='vibration',
    )
    name: str = 'vibration_rectification'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'k',
            'rad/s/(m/s^2)^2',
            prior_std=math.radians(1.0),
            typical=TypicalRange(math.radians(0.15), math.radians(1.5)),
        ),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(block.vibration_m2_s4)
