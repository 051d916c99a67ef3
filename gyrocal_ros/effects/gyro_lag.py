"""A low-pass filter inside the sensor delays what it reads."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class GyroLag(LinearGyroEffect):
    """`tau dw/dt` undoes a first-order low-pass filter of time constant tau."""

    name: str = 'gyro_lag'
    coefficients: tuple[Coefficient, ...] = (Coefficient('tau', 's', prior_std=0.03),)

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(block.yaw_acceleration_rad_s2)
