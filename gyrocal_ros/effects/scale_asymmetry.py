"""Turns to one side are read with another scale factor than turns to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class ScaleAsymmetry(LinearGyroEffect):
    """`c |w|`: half the difference of the scale factors to both sides."""

    name: str = 'scale_asymmetry'
    coefficients: tuple[Coefficient, ...] = (Coefficient('c', '1', prior_std=0.01),)

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(np.abs(block.rate_rad_s[:, 2]))
