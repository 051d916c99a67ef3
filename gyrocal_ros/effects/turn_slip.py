"""The wheels slip while the robot turns, so that odometry counts distance that was not travelled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, Place


@dataclass(frozen=True)
class TurnSlip:
    """True distance = odometry less `k |turn|`."""

    acts_on: ClassVar[Place] = 'wheels'
    name: str = 'turn_slip'
    coefficients: tuple[Coefficient, ...] = (Coefficient('k', 'm/rad', prior_std=0.02),)

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """`-k |w| dt`."""
        turn = np.abs(block.rate_rad_s[:, 2]) * block.dt_s
        return -values[0] * turn, -turn[:, None]
