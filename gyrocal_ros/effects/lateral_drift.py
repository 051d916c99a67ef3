"""The floor carries the robot sideways as it travels, as the pile of a carpet does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, Place


@dataclass(frozen=True)
class LateralDrift:
    """`(lx, ly) |d|` in the world, per metre travelled."""

    acts_on: ClassVar[Place] = 'ground'
    name: str = 'lateral_drift'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('lx', '1', prior_std=0.02),
        Coefficient('ly', '1', prior_std=0.02),
    )

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Displacement (3,) over the block and its derivative (3, 2)."""
        travelled = float(np.abs(block.distance_m).sum())
        by_values = travelled * np.eye(3)[:, :2]
        return by_values @ values, by_values
