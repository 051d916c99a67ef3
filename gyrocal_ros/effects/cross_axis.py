"""The sensitive axis is not quite vertical, so roll and pitch rates leak in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class CrossAxis(LinearGyroEffect):
    """`Mx wx + My wy`, the paper's neglected M."""

    about: ClassVar[Explanation] = Explanation(
        physics='The sensitive axis is not quite upright: the chip is tilted in its housing, the '
        'housing on the board, or the board in the robot. Rolling and pitching over thresholds and '
        'bumps then reads as turning. On a smooth level floor nothing shows.',
        equation='w = w_n + Mx wx + My wy',
        usual_size='0.5 to 3 %',
        best_motion='thresholds, bumps and ramps, crossed straight and at an angle',
        source='Lee et al. 2012, eq. (5); Titterton and Weston 2004, Strapdown Inertial Navigation '
        'Technology',
        example=(0.02, -0.02),
        shown_against='roll',
    )
    name: str = 'cross_axis'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('mx', '1', prior_std=0.02, typical=TypicalRange(0.03, 0.05)),
        Coefficient('my', '1', prior_std=0.02, typical=TypicalRange(0.02, 0.05)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """Return the columns (N, 2)."""
        return column(block.rate_rad_s[:, 0], block.rate_rad_s[:, 1])
