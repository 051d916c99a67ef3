"""Bias or scale swings to and fro in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Of
from gyrocal_ros.effects.learned.signals import required
from gyrocal_ros.effects.learned.step import TIME
from gyrocal_ros.model.sensor import Coefficient

SINE: Literal['sine'] = 'sine'
ORDERS = np.arange(1.0, 4.0)
"""The period and its harmonics: what is switched on and off is nine tenths of these."""


@dataclass(frozen=True)
class _Swing(LinearGyroEffect):
    """What a wave and its closed form have in common."""

    holds_once: ClassVar[bool] = True
    name: str
    coefficients: tuple[Coefficient, ...]
    period_s: float = 30.0

    @property
    def of(self) -> Of:
        """What swings."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    @property
    def parameters(self) -> tuple[float, ...]:
        """The period, in which it is not linear."""
        return (self.period_s,)

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of a change of each of `parameters` that changes it."""
        return (self.period_s,)

    def at(self, parameters: tuple[float, ...]) -> Self:
        """Return the effect with other `parameters`."""
        return replace(self, period_s=parameters[0])

    def _explained(self, equation: str) -> Explanation:
        return Explanation(
            physics='Bias or scale swings with a fixed period: a heater that is switched, a pump, the beat '
            'of a vibration with the sampling. The phase is that of this recording.',
            equation=equation + ' w_n' * (self.of == 'scale'),
            usual_size='as found',
            best_motion='five periods or more, with turns in all phases',
            source='IEEE Std 952-1997, Annex C, sinusoidal noise',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='time',
        )

    def _waves(self, orders: Array, block: MotionBlock) -> Array:
        phase = 2.0 * np.pi * orders * block.time_s[:, None] / self.period_s
        waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
        return waves * block.rate_rad_s[:, 2:] if self.of == 'scale' else waves


@dataclass(frozen=True)
class Wave(_Swing):
    """`sum_k a_k sin(2 pi k t / period) + b_k cos(2 pi k t / period)`; its phase is that of one recording."""

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return self._explained('w = w_n + sum_k (a_k sin(2 pi k t / T) + b_k cos(2 pi k t / T))')

    def columns(self, block: MotionBlock) -> Array:
        """Return the sines, then the cosines (N, 2 k)."""
        return self._waves(ORDERS, block)


@dataclass(frozen=True)
class Sine(_Swing):
    """`a sin(2 pi t / period) + b cos(2 pi t / period)`: the closed form of a wave without harmonics."""

    form: Literal['sine'] = SINE

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return self._explained('w = w_n + (a sin(2 pi t / T) + b cos(2 pi t / T))')

    def columns(self, block: MotionBlock) -> Array:
        """Return sine and cosine (N, 2)."""
        return self._waves(ORDERS[:1], block)


def wave(of: Of, signal: str = TIME, period_s: float = 30.0) -> Wave:
    """Make a wave with a prior of usual size.

    Raises:
        ConfigError: the signal is not the time.
    """
    name = f'{of}_wave:{required(signal, (TIME,), f"{of}_wave")}'
    items = tuple(
        Coefficient(f'{part}_{order:.0f}', UNIT[of], TYPICAL[of] / order)
        for part in ('sine', 'cosine')
        for order in ORDERS.tolist()
    )
    return Wave(name, items, period_s)


def sine_of(name: str, period_s: float = 30.0) -> Sine:
    """Make the closed form of a wave, with a prior of usual size.

    Args:
        name: name of the wave.
        period_s: its period.
    """
    of: Of = 'scale' if name.startswith('scale') else 'bias'
    items = tuple(Coefficient(part, UNIT[of], TYPICAL[of]) for part in ('sine', 'cosine'))
    return Sine(name, items, period_s)
