"""The scale factor follows the temperature of the part."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column, recorded
from gyrocal_ros.model.sensor import Coefficient

REFERENCE_C = 25.0


@dataclass(frozen=True)
class ScaleTemperature(LinearGyroEffect):
    """`k (T - T0) w`, T0 = 25 deg C."""

    name: str = 'scale_temperature'
    coefficients: tuple[Coefficient, ...] = (Coefficient('k', '1/K', prior_std=0.001),)

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(recorded(block.temperature_c - REFERENCE_C) * block.rate_rad_s[:, 2])
