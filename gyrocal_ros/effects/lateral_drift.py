"""The floor carries the robot sideways as it travels, as the pile of a carpet does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, Place, TypicalRange


@dataclass(frozen=True)
class LateralDrift:
    """`(lx, ly) |d|` in the world, per metre travelled."""

    about: ClassVar[Explanation] = Explanation(
        physics='The pile of a carpet leans one way and carries the robot along a little with every '
        'metre it travels, whatever its heading. Neither the wheels nor the gyro measure it.',
        equation='p = p_odometry + (lx, ly) |d| in the world',
        usual_size='1 to 3 %',
        best_motion='lanes in at least two directions across the same carpet',
        source='Carpet drift estimation using differential sensors or visual measurements, US patent '
        '9,223,312 (iRobot)',
        example=(0.02, 0.01),
        shown_against='distance',
    )
    acts_on: ClassVar[Place] = 'ground'
    name: str = 'lateral_drift'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('lx', '1', prior_std=0.02, typical=TypicalRange(0.007, 0.03)),
        Coefficient('ly', '1', prior_std=0.02, typical=TypicalRange(0.007, 0.03)),
    )

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Return the displacement (3,) over the block and its derivative (3, 2)."""
        _, _, travelled_m, _ = block.way_and_turn()
        by_values = np.array([[travelled_m, 0.0], [0.0, travelled_m], [0.0, 0.0]])
        return by_values @ values, by_values
