"""Bias or scale jumps at a moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.effects.learned.curve import TYPICAL, UNIT, Of
from gyrocal_ros.effects.learned.signals import required
from gyrocal_ros.model.sensor import Coefficient

TIME = 'time'


@dataclass(frozen=True)
class Step(LinearGyroEffect):
    """`step` from the moment `at_s` on; valid for one recording."""

    holds_once: ClassVar[bool] = True
    name: str
    coefficients: tuple[Coefficient, ...]
    at_s: float = 0.0
    """Moment, since the first sample of the gyro."""

    @property
    def about(self) -> Explanation:
        """Description for people."""
        return Explanation(
            physics='Bias or scale jumps at one moment: after a blow, a restart of the sensor, or a change '
            'of its supply. It is valid for this recording only.',
            equation=f'w = w_n + step{" w_n" if self.of == "scale" else ""}, from the moment on',
            usual_size='as found',
            best_motion='turns before and after the moment',
            source='Willsky and Jones 1976, A generalized likelihood ratio approach to the detection and '
            'estimation of jumps in linear systems, IEEE Transactions on Automatic Control 21(1)',
            example=tuple(item.prior_std for item in self.coefficients),
            shown_against='time',
        )

    @property
    def of(self) -> Of:
        """What jumps."""
        return 'scale' if self.name.startswith('scale') else 'bias'

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        after = (block.time_s >= self.at_s).astype(float)
        return column(after * block.rate_rad_s[:, 2] if self.of == 'scale' else after)


def step(of: Of, signal: str = TIME, at_s: float = 0.0) -> Step:
    """Make a step with a prior of usual size.

    Raises:
        ConfigError: the signal is not the time.
    """
    name = f'{of}_step:{required(signal, (TIME,), f"{of}_step")}'
    return Step(name, (Coefficient('step', UNIT[of], TYPICAL[of]),), at_s)
