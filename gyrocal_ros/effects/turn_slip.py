"""The wheels slip while the robot turns, so that odometry counts distance that was not travelled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange


@dataclass(frozen=True)
class TurnSlip:
    """True distance = odometry minus `k |turn|`."""

    about: ClassVar[Explanation] = Explanation(
        physics='While the robot turns its wheels scrub over the floor, and odometry counts distance '
        'that was not travelled. It happens on polished floors and with wide or worn tyres, and only '
        'while turning.',
        equation='d = d_odometry - k |turn|',
        usual_size='some mm to cm per rad',
        best_motion='many turns, on the spot and in arcs, with straight lanes for comparison',
        source='Borenstein, Everett and Feng 1996, Where am I? Sensors and methods for mobile robot '
        'positioning, University of Michigan',
        example=(0.02,),
        shown_against='rate',
    )
    acts_on: ClassVar[Place] = 'wheels'
    name: str = 'turn_slip'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', 'm/rad', prior_std=0.02, typical=TypicalRange(0.003, 0.04, signed=False)),
    )

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Return `-k |w| dt` and its derivative."""
        turn = np.abs(block.rate_rad_s[:, 2]) * block.dt_s
        return -values[0] * turn, -turn[:, None]
