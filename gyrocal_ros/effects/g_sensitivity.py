"""Acceleration bends the vibrating structure and is read as rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class GSensitivity(LinearGyroEffect):
    """`gx ax + gy ay`, the paper's neglected Bg."""

    name: str = 'g_sensitivity'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('gx', 'rad/s/(m/s^2)', prior_std=math.radians(0.02)),
        Coefficient('gy', 'rad/s/(m/s^2)', prior_std=math.radians(0.02)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """(N, 2)"""
        return column(block.specific_force_m_s2[:, 0], block.specific_force_m_s2[:, 1])
