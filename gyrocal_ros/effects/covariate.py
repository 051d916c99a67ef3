"""Bias or scale factor that follows any other recorded signal: motor current, fan, supply voltage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.recording import Signal
from gyrocal_ros.model.sensor import Coefficient, TypicalRange


@dataclass(frozen=True)
class CovariateBias(LinearGyroEffect):
    """`k (c - c0)`; named with its signal, `covariate_bias:battery_state.current`."""

    about: ClassVar[Explanation] = Explanation(
        physics='Another recorded signal is correlated with what the sensor reads at rest: the current '
        'of a motor nearby, the speed of a fan, the voltage of the battery. Magnetic fields, heat, '
        'shaking or a weak supply may be the cause. Slow signals are correlated with anything slow, so '
        'look for a reason before you trust it.',
        equation='w = w_n + k (c - mean c)',
        usual_size='0.01 to 0.2 deg/s in all',
        best_motion='what makes the signal change, again and again: motors and fan on and off at rest',
        twins=('bias_temperature', 'bias_warmup', 'vibration_rectification'),
        source='Ljung 1999, System Identification: Theory for the User, chapter 16: residuals against '
        'recorded signals',
        example=(math.radians(0.1),),
        shown_against='signal',
    )
    signal: str
    name: str
    coefficients: tuple[Coefficient, ...]
    reference: float = 0.0
    """c0, the mean of the signal over the recording in which the effect was found."""

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(deviation(block, self.signal, self.reference))

    def counted_from(self, reference: float) -> CovariateBias:
        """Return the same effect with another c0."""
        return replace(self, reference=reference)


@dataclass(frozen=True)
class CovariateScale(LinearGyroEffect):
    """`k (c - c0) w`."""

    about: ClassVar[Explanation] = Explanation(
        physics='Another recorded signal is correlated with how strongly the sensor responds to turns, '
        'as the supply voltage is where the output is measured as a fraction of it. At rest nothing '
        'shows.',
        equation='w = w_n + k (c - mean c) w_n',
        usual_size='0.1 to 1 % in all',
        best_motion='turns with the signal high and low: a full and an empty battery, fan on and off',
        twins=('scale_temperature', 'scale_factor'),
        source='Ljung 1999, System Identification: Theory for the User, chapter 16: residuals against '
        'recorded signals',
        example=(0.005,),
        shown_against='signal',
    )
    signal: str
    name: str
    coefficients: tuple[Coefficient, ...]
    reference: float = 0.0

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        return column(deviation(block, self.signal, self.reference) * block.rate_rad_s[:, 2])

    def counted_from(self, reference: float) -> CovariateScale:
        """Return the same effect with another c0."""
        return replace(self, reference=reference)


def covariate_bias(signal: str, reference: float = 0.0, spread: float = 1.0) -> CovariateBias:
    """Make the effect for a signal that varies by about `spread`; its prior is 0.1 deg/s for that."""
    typical = TypicalRange(math.radians(0.01) / spread, math.radians(0.2) / spread)
    item = Coefficient('k', 'rad/s/unit', math.radians(0.1) / spread, typical=typical)
    return CovariateBias(signal, f'covariate_bias:{signal}', (item,), reference)


def covariate_scale(signal: str, reference: float = 0.0, spread: float = 1.0) -> CovariateScale:
    """Make the effect for a signal that varies by about `spread`; its prior is 1 % for that."""
    item = Coefficient('k', '1/unit', 0.01 / spread, typical=TypicalRange(5e-4 / spread, 0.01 / spread))
    return CovariateScale(signal, f'covariate_scale:{signal}', (item,), reference)


def covariate_effects(signals: Sequence[Signal]) -> list[CovariateBias | CovariateScale]:
    """Make the effect of each kind for each signal."""
    return [
        make(signal.name, signal.mean, signal.spread)
        for make in (covariate_bias, covariate_scale)
        for signal in signals
    ]


@dataclass(frozen=True)
class CovariateBank(LinearGyroEffect):
    """All `covariate_effects` of some signals as one effect with a coefficient for each, for speed."""

    signals: tuple[Signal, ...]
    name: str = 'covariate bank'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:  # type: ignore[override]
        """One coefficient for each effect, in the order of `covariate_effects`."""
        return tuple(effect.coefficients[0] for effect in covariate_effects(self.signals))

    def columns(self, block: MotionBlock) -> Array:
        """Return the columns (N, 2 q) for q signals."""
        rows = np.array([deviation(block, signal.name, signal.mean) for signal in self.signals])
        return np.concatenate([rows, rows * block.rate_rad_s[:, 2]]).T


def covariate_bank(signals: Sequence[Signal]) -> CovariateBank:
    """Make the one effect that holds a column for each of the `covariate_effects` of some signals."""
    return CovariateBank(tuple(signals))


def deviation(block: MotionBlock, signal: str, reference: float) -> Array:
    """Return a recorded signal less its reference, (N,); zero where it is not recorded."""
    values = block.covariates.get(signal)
    return np.zeros(len(block.dt_s)) if values is None else values - reference
