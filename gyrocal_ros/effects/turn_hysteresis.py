"""After a turn the bias is offset for a while, to the side of the turn."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, TypeAlias, get_args

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.effects.fading import fading_memory
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place, TypicalRange

Drive: TypeAlias = Literal['rate', 'side']

MIN_TIME_CONSTANT_S = 0.5
TURNING_RAD_S = math.radians(5.0)
"""Threshold of the rate of a turn, where only the side drives the memory."""


@dataclass(frozen=True)
class TurnHysteresis:
    """`k h` with the fading memory `dh/dt = (u - h) / tau` of the turns.

    The drive u is the nominal rate in rad/s, or only the sign of the turn.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='After a turn the sensor does not return to quite the same zero. What it reads at rest '
        'is offset to one side, depending on the side of the last turn, and decays over some seconds '
        'or minutes. Turns to alternate sides cancel, turns to one side add up.',
        equation='w = w_n + k h, dh/dt = (w_n - h) / tau',
        usual_size='0.01 to 0.2 deg/s after a turn',
        best_motion='several turns to one side, then a long rest; the same to the other side',
        twins=('bias',),
        source='IEEE Std 528, Inertial Sensor Terminology: hysteresis error',
        example=(math.radians(0.3), 20.0),
        shown_against='turn',
    )
    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'turn_hysteresis'
    driven_by: Drive = 'rate'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'k',
            'rad/s',
            prior_std=math.radians(1.0),
            typical=TypicalRange(math.radians(0.06), math.radians(1.0)),
        ),
        Coefficient(
            'time_constant',
            's',
            prior_std=20.0,
            prior_mean=20.0,
            scan=(2.5, 4.0, 6.5, 10.5, 17.0, 27.5, 44.5),
            typical=TypicalRange(4.0, 40.0, signed=False, is_strength=False),
        ),
    )

    def forms(self) -> tuple[TurnHysteresis, ...]:
        """Return the effect with a memory driven by the rate, and by the side alone."""
        return tuple(replace(self, driven_by=drive) for drive in get_args(Drive))

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution and its derivative (N, 2); the memory is h and its derivative by tau."""
        k, tau = values[0], max(values[1], MIN_TIME_CONSTANT_S)
        h_start, slope_start = memory if memory is not None else (np.zeros(1), 0.0)
        drive = self._drive(block.rate_rad_s[:, 2])
        h, growth = fading_memory(drive, block.dt_s, np.array([tau]), h_start)
        h, growth = h[:, 0], growth[:, 0]
        pushes = (h[:-1] - drive) * growth[:-1] * block.dt_s / tau**2
        slopes = np.concatenate([[slope_start], (slope_start + np.cumsum(pushes)) / growth[1:]])
        middle = 0.5 * (h[1:] + h[:-1])
        by_values = np.stack([middle, 0.5 * k * (slopes[1:] + slopes[:-1])], axis=1)
        return GyroTerm(k * middle, by_values, memory=(h[-1:], slopes[-1]))

    def columns_at(self, block: MotionBlock, scan: Array, memory: Memory) -> tuple[Array, Memory]:
        """Return the derivative (N, q) with respect to k at q time constants."""
        h_start = memory if memory is not None else np.zeros(len(scan))
        h, _ = fading_memory(self._drive(block.rate_rad_s[:, 2]), block.dt_s, scan, h_start)
        return 0.5 * (h[1:] + h[:-1]), h[-1]

    def _drive(self, rate_rad_s: Array) -> Array:
        if self.driven_by == 'rate':
            return rate_rad_s
        return np.sign(rate_rad_s) * (np.abs(rate_rad_s) > TURNING_RAD_S)
