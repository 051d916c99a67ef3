"""The scale-factor function: powers of the nominal rate, the paper's a1 ... an."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient

FULL_RATE_RAD_S = math.radians(100.0)
USUAL_NONLINEARITY = 0.01
"""Departure from a straight line at 100 deg/s, the prior of every power above the first."""


@dataclass(frozen=True)
class ScalePower(LinearGyroEffect):
    """`a_n w^n`: the n-th power of the scale-factor function, first column of U for n = 1."""

    power: int
    name: str
    coefficients: tuple[Coefficient, ...]

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(block.rate_rad_s[:, 2] ** self.power)


def scale_power(power: int, prior_std: float | None = None) -> ScalePower:
    """The n-th power; the first three have names of their own, further ones are `scale_power_N`."""
    names = {1: 'scale_factor', 2: 'scale_quadratic', 3: 'scale_cubic'}
    units = {1: '1', 2: 's/rad'}
    if prior_std is None:
        prior_std = 0.1 if power == 1 else USUAL_NONLINEARITY / FULL_RATE_RAD_S ** (power - 1)
    name = names.get(power, f'scale_power_{power}')
    unit = units.get(power, f's^{power - 1}/rad^{power - 1}')
    return ScalePower(power, name, (Coefficient(f'a{power}', unit, prior_std),))
