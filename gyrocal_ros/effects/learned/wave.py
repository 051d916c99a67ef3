"""Bias or scale swings to and fro in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

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
class Wave(LinearGyroEffect):
    """`sum_k a_k sin(2 pi k t / period) + b_k cos(2 pi k t / period)`; its phase is that of one recording."""

    name: str
    coefficients: tuple[Coefficient, ...]
    period_s: float = 30.0

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='Bias or scale swings with a fixed period: a heater that is switched, a pump, the beat '
            'of a vibration with the sampling. The phase is that of this recording.',
            equation=f'w = w_n + sum_k (a_k sin(2 pi k t / T) + b_k cos(2 pi k t / T))'
            f'{" w_n" * (self.of == "scale")}',
            usual_size='as found',
            best_motion='five periods or more, with turns in all phases',
            source='IEEE Std 952-1997, Annex C, sinusoidal noise',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='time',
        )

    @property
    def of(self) -> Of:
        """What swings."""
        return _of(self.name)

    @property
    def parameters(self) -> tuple[float, ...]:
        """The period, in which it is not linear."""
        return (self.period_s,)

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of a change of each of `parameters` that changes the wave."""
        return (self.period_s,)

    def at(self, parameters: tuple[float, ...]) -> Wave:
        """Return the effect with other `parameters`."""
        return replace(self, period_s=parameters[0])

    def columns(self, block: MotionBlock) -> Array:
        """Return the sines, then the cosines (N, 2 k)."""
        return _waves(self.of, ORDERS, self.period_s, block)


@dataclass(frozen=True)
class Sine(LinearGyroEffect):
    """`a sin(2 pi t / period) + b cos(2 pi t / period)`: the closed form of a wave without harmonics."""

    name: str
    coefficients: tuple[Coefficient, ...]
    form: Literal['sine'] = SINE
    period_s: float = 30.0

    @property
    def about(self) -> Explanation:
        """Description for people."""
        times = ' w_n' * (_of(self.name) == 'scale')
        return replace(
            wave(_of(self.name), period_s=self.period_s).about,
            equation=f'w = w_n + (a sin(2 pi t / T) + b cos(2 pi t / T)){times}, T = {self.period_s:.3g} s',
            example=tuple(item.prior_std for item in self.coefficients),
        )

    @property
    def parameters(self) -> tuple[float, ...]:
        """The period, in which it is not linear."""
        return (self.period_s,)

    @property
    def scales(self) -> tuple[float, ...]:
        """Size of a change of each of `parameters` that changes the wave."""
        return (self.period_s,)

    def at(self, parameters: tuple[float, ...]) -> Sine:
        """Return the effect with other `parameters`."""
        return replace(self, period_s=parameters[0])

    def columns(self, block: MotionBlock) -> Array:
        """Return sine and cosine (N, 2)."""
        return _waves(_of(self.name), ORDERS[:1], self.period_s, block)


def _of(name: str) -> Of:
    return 'scale' if name.startswith('scale') else 'bias'


def _waves(of: Of, orders: Array, period_s: float, block: MotionBlock) -> Array:
    phase = 2.0 * np.pi * orders * block.time_s[:, None] / period_s
    waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
    return waves * block.rate_rad_s[:, 2:] if of == 'scale' else waves


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
    of = _of(name)
    items = tuple(Coefficient(part, UNIT[of], TYPICAL[of]) for part in ('sine', 'cosine'))
    return Sine(name, items, period_s=period_s)
