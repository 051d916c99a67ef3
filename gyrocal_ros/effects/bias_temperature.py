"""The bias follows the temperature of the part."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column, recorded
from gyrocal_ros.model.sensor import Coefficient

REFERENCE_C = 25.0


@dataclass(frozen=True)
class BiasTemperature(LinearGyroEffect):
    """`k (T - T0)`, T0 = 25 deg C."""

    name: str = 'bias_temperature'
    coefficients: tuple[Coefficient, ...] = (Coefficient('k', 'rad/s/K', prior_std=math.radians(0.05)),)

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(recorded(block.temperature_c - REFERENCE_C))
