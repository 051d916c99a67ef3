"""The wheels are larger or smaller than believed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, Place


@dataclass(frozen=True)
class WheelScale:
    """True distance = (1 + s) times odometry."""

    acts_on: ClassVar[Place] = 'wheels'
    name: str = 'wheel_scale'
    coefficients: tuple[Coefficient, ...] = (Coefficient('s', '1', prior_std=0.03),)

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """`s d`."""
        return values[0] * block.distance_m, block.distance_m[:, None]
