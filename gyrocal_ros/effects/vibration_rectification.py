"""Vibration that is symmetric in force comes out lopsided in rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class VibrationRectification(LinearGyroEffect):
    """`k var(a)`, the variance of the specific force within the block."""

    name: str = 'vibration_rectification'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', 'rad/s/(m/s^2)^2', prior_std=math.radians(0.5)),
    )

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        force = block.specific_force_m_s2
        variance = float(np.var(force, axis=0).sum())
        return column(np.full(len(force), variance))
