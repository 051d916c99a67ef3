"""A low-pass filter inside the sensor delays what it reads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """`w_n + tau / scale dw_n/dt` is what goes in: the low-pass filter, by the trapezoidal rule."""
        ratio = 2.0 * values[0] / scale_factor / dt_s
        share, kept = 1.0 / (1.0 + ratio), (ratio - 1.0) / (1.0 + ratio)
        pushed = share[1:] * (nominal_rad_s[1:] + nominal_rad_s[:-1])
        level = float(nominal_rad_s[0])
        levels = [level]
        for kept_share, push in zip(kept[1:].tolist(), pushed.tolist(), strict=True):
            level = kept_share * level + push
            levels.append(level)
        return np.array(levels)
