"""Acceleration bends the vibrating structure and is read as rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class GSensitivity(LinearGyroEffect):
    """`gx ax + gy ay`, the paper's neglected Bg."""

    about: ClassVar[Explanation] = Explanation(
        physics='Acceleration pulls the vibrating mass to one side, and the sensor reads part of that '
        'as rotation. Speeding up, braking, driving round a bend and standing on a slope each add a '
        'small false rate for as long as they last.',
        equation='w = w_n + gx ax + gy ay',
        usual_size='0.005 to 0.1 deg/s/(m/s^2)',
        best_motion='hard starts and stops, fast bends, rests on a ramp in several directions',
        source='Weinberg 2011, Gyro mechanical performance: the most important parameter, Analog '
        'Devices MS-2158',
        example=(math.radians(0.05), math.radians(-0.05)),
        shown_against='force',
    )
    name: str = 'g_sensitivity'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'gx',
            'rad/s/(m/s^2)',
            prior_std=math.radians(0.1),
            typical=TypicalRange(math.radians(0.05), math.radians(0.2)),
        ),
        Coefficient(
            'gy',
            'rad/s/(m/s^2)',
            prior_std=math.radians(0.1),
            typical=TypicalRange(math.radians(0.08), math.radians(0.2)),
        ),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the columns (N, 2)."""
        return column(block.specific_force_m_s2[:, 0], block.specific_force_m_s2[:, 1])
