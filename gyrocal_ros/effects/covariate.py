"""Bias or scale factor that follows any other recorded number: motor current, fan, supply voltage."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class CovariateBias(LinearGyroEffect):
    """`k (c - c0)`; named with its signal, `covariate_bias:battery_state.current`."""

    signal: str
    name: str
    coefficients: tuple[Coefficient, ...]
    reference: float = 0.0
    """c0, the mean of the signal over the recording it was found in."""

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(deviation(block, self.signal, self.reference))

    def counted_from(self, reference: float) -> CovariateBias:
        """The same with another c0."""
        return replace(self, reference=reference)


@dataclass(frozen=True)
class CovariateScale(LinearGyroEffect):
    """`k (c - c0) w`."""

    signal: str
    name: str
    coefficients: tuple[Coefficient, ...]
    reference: float = 0.0

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1)"""
        return column(deviation(block, self.signal, self.reference) * block.rate_rad_s[:, 2])

    def counted_from(self, reference: float) -> CovariateScale:
        """The same with another c0."""
        return replace(self, reference=reference)


def covariate_bias(signal: str, reference: float = 0.0, spread: float = 1.0) -> CovariateBias:
    """The effect for a signal that varies by about `spread`; its prior is 0.1 deg/s for that."""
    prior_std = math.radians(0.1) / spread
    item = Coefficient('k', 'rad/s/unit', prior_std)
    return CovariateBias(signal, f'covariate_bias:{signal}', (item,), reference)


def covariate_scale(signal: str, reference: float = 0.0, spread: float = 1.0) -> CovariateScale:
    """The effect for a signal that varies by about `spread`; its prior is 1 % for that."""
    item = Coefficient('k', '1/unit', 0.01 / spread)
    return CovariateScale(signal, f'covariate_scale:{signal}', (item,), reference)


def deviation(block: MotionBlock, signal: str, reference: float) -> Array:
    """How far a recorded signal is from its reference, (N,); zero where it is not recorded."""
    values = block.covariates.get(signal)
    return np.zeros(len(block.dt_s)) if values is None else values - reference
