"""Vibration that is symmetric in force comes out lopsided in rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class VibrationRectification(LinearGyroEffect):
    """`k var(a)`, with the variance of the specific force of late, all axes together."""

    name: str = 'vibration_rectification'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', 'rad/s/(m/s^2)^2', prior_std=math.radians(0.5)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(block.vibration_m2_s4)
