"""Turns to one side are read with another scale factor than turns to the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class ScaleAsymmetry(LinearGyroEffect):
    """`c |w|`: half the difference of the scale factors to both sides."""

    about: ClassVar[Explanation] = Explanation(
        physics='The sensor reads turns to the left a little differently from turns to the right. Its '
        'electronics treat the two halves of the signal differently, or the sensing element is stiffer '
        'to one side. A full turn to the left then reads longer than a full turn to the right, '
        'and after many turns to one side the heading has an error to that side.',
        equation='w = w_n + c |w_n|',
        usual_size='0.1 to 1 %',
        best_motion='the same turns to both sides, as many to the left as to the right',
        twins=('scale_quadratic',),
        source='IEEE Std 528, Inertial Sensor Terminology: scale factor asymmetry',
        shows_in_any_turns=True,
        example=(0.003,),
        shown_against='rate',
    )
    name: str = 'scale_asymmetry'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('c', '1', prior_std=0.01, typical=TypicalRange(5e-4, 0.01)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(np.abs(block.rate_rad_s[:, 2]))
