"""Many variants of one effect carried at once: one contribution, a column each, none of them on.

A coefficient inside a nonlinear function, such as a time constant, is covered by a few columns over
its range. Asked one by one, the variants would cost more than the whole filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import LinearGyroEffect
from gyrocal_ros.effects.covariate import deviation
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place


def _amplitudes(count: int) -> tuple[Coefficient, ...]:
    return tuple(Coefficient(f'k{i}', 'rad/s', math.radians(0.1)) for i in range(count))


@dataclass(frozen=True)
class Warmups(LinearGyroEffect):
    """`bias_warmup` at several time constants."""

    times_s: tuple[float, ...]
    name: str = 'warmups'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:  # type: ignore[override]
        """One amplitude for each time constant."""
        return _amplitudes(len(self.times_s))

    def columns(self, block: MotionBlock) -> Array:
        """(N, q)"""
        return -np.exp(-block.time_s[:, None] / np.array(self.times_s))


@dataclass(frozen=True)
class Followers(LinearGyroEffect):
    """`covariate_bias` of several signals, then `covariate_scale` of the same."""

    references: tuple[tuple[str, float], ...]
    """Name of each signal, and what it is counted from."""
    name: str = 'followers'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:  # type: ignore[override]
        """One for each signal and kind."""
        return _amplitudes(2 * len(self.references))

    def columns(self, block: MotionBlock) -> Array:
        """(N, 2 q)"""
        deviations = np.stack([deviation(block, *reference) for reference in self.references], axis=1)
        return np.concatenate([deviations, deviations * block.rate_rad_s[:, 2:]], axis=1)


@dataclass(frozen=True)
class Hystereses:
    """`turn_hysteresis` driven by rate or by side, at several time constants each."""

    acts_on: ClassVar[Place] = 'gyro'
    variants: tuple[TurnHysteresis, ...]
    name: str = 'hystereses'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """One amplitude for each variant."""
        return _amplitudes(len(self.variants))

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Contribution and its derivative (N, q); remembers the fading memories (q,)."""
        before = memory if memory is not None else np.zeros(len(self.variants))
        rate = block.rate_rad_s[:, 2]
        drives = {variant.driven_by: variant._drive(rate) for variant in self.variants}
        drive = np.stack([drives[variant.driven_by] for variant in self.variants], axis=1)
        times_s = np.array([variant.coefficients[1].prior_mean for variant in self.variants])
        growth = np.exp(np.cumsum(block.dt_s)[:, None] / times_s)
        earlier = np.concatenate([np.ones((1, len(times_s))), growth[:-1]])
        level = (before + np.cumsum(drive * (growth - earlier), axis=0)) / growth
        columns = 0.5 * (level + np.concatenate([before[None], level[:-1]]))
        return GyroTerm(columns @ values, columns, memory=level[-1])
