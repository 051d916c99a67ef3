"""The sensitive axis is not quite vertical, so roll and pitch rates leak in."""

from __future__ import annotations

from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class CrossAxis(LinearGyroEffect):
    """`Mx wx + My wy`, the paper's neglected M."""

    name: str = 'cross_axis'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('mx', '1', prior_std=0.02),
        Coefficient('my', '1', prior_std=0.02),
    )

    def columns(self, block: MotionBlock) -> Array:
        """(N, 2)"""
        return column(block.rate_rad_s[:, 0], block.rate_rad_s[:, 1])
