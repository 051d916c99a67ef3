"""Bias or scale swings to and fro in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Of
from gyrocal_ros.effects.learned.signals import required
from gyrocal_ros.effects.learned.step import TIME
from gyrocal_ros.model.sensor import Coefficient


@dataclass(frozen=True)
class Wave(LinearGyroEffect):
    """`c1 sin(2 pi t / period) + c2 cos(2 pi t / period)`; its phase is that of one recording."""

    name: str
    coefficients: tuple[Coefficient, ...]
    period_s: float = 30.0

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='Bias or scale swings with a fixed period: a heater that is switched, a pump, the beat '
            'of a vibration with the sampling. The phase is that of this recording.',
            equation=f'w = w_n + (c1 sin(2 pi t / T) + c2 cos(2 pi t / T)){" w_n" * (self.of == "scale")}',
            usual_size='as found',
            best_motion='five periods or more, with turns in all phases',
            source='IEEE Std 952-1997, Annex C, sinusoidal noise',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='time',
        )

    @property
    def of(self) -> Of:
        """What swings."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    def columns(self, block: MotionBlock) -> Array:
        """Return sine and cosine (N, 2)."""
        phase = 2.0 * np.pi * block.time_s / self.period_s
        waves = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        return waves * block.rate_rad_s[:, 2:] if self.of == 'scale' else waves


def wave(of: Of, signal: str = TIME, period_s: float = 30.0) -> Wave:
    """Make a wave with a prior of usual size.

    Raises:
        ConfigError: the signal is not the time.
    """
    name = f'{of}_wave:{required(signal, (TIME,), f"{of}_wave")}'
    items = tuple(Coefficient(part, UNIT[of], TYPICAL[of]) for part in ('sine', 'cosine'))
    return Wave(name, items, period_s)
