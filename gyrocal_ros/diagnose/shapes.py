"""Shapes that are no physics: how an effect outside the library shows itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.effects.covariate import deviation
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class BiasStep(LinearGyroEffect):
    """The bias jumps at a moment, as after a knock."""

    at_s: float
    name: str
    coefficients: tuple[Coefficient, ...]

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1): zero before, one after."""
        return column((block.time_s >= self.at_s).astype(float))


def bias_step(at_s: float) -> BiasStep:
    """A jump of the bias at `at_s` after the first IMU sample."""
    return BiasStep(at_s, f'bias_step:{at_s:.0f}', (Coefficient('k', 'rad/s', math.radians(0.1)),))


@dataclass(frozen=True)
class Hats(LinearGyroEffect):
    """Bias or scale as any function of a signal: straight between the knots, flat beyond them."""

    signal: str
    of_scale: bool
    knots: tuple[float, ...]
    name: str
    coefficients: tuple[Coefficient, ...]

    def columns(self, block: MotionBlock) -> Array:
        """(N, k) hat functions, k one less than the knots: the first knot is the reference."""
        values = _values(block, self.signal)
        hats = np.stack([np.interp(values, self.knots, row) for row in np.eye(len(self.knots))[1:]], axis=1)
        return hats * block.rate_rad_s[:, 2:] if self.of_scale else hats


def hats(signal: str, of_scale: bool, knots: tuple[float, ...]) -> Hats:
    """A free function of a signal, by its values at the knots less that at the first."""
    unit, prior = ('1', 0.02) if of_scale else ('rad/s', math.radians(0.2))
    kind = 'scale' if of_scale else 'bias'
    items = tuple(Coefficient(f'k{i}', unit, prior) for i in range(1, len(knots)))
    return Hats(signal, of_scale, knots, f'{kind}_shape:{signal}', items)


def _values(block: MotionBlock, signal: str) -> Array:
    if signal == 'time':
        return block.time_s
    if signal == 'rate':
        return block.rate_rad_s[:, 2]
    if signal == 'temperature':
        return np.nan_to_num(block.temperature_c)
    return deviation(block, signal, 0.0)
