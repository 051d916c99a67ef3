"""After a turn the bias stands off for a while, to the side that was turned to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place

MIN_TIME_CONSTANT_S = 0.5
TURNING_RAD_S = math.radians(5.0)
"""Slower than this does not count as a turn, where only the side counts."""


@dataclass(frozen=True)
class TurnHysteresis:
    """`k h` with the fading memory `dh/dt = (u - h) / tau` of the turns.

    The drive u is the nominal rate in rad/s, or only the side turned to.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='After a turn the sensor does not come back to quite the same zero. What it reads at '
        'rest stands off to one side, depending on where the robot turned to last, and fades away '
        'over some seconds or minutes. Turns to alternate sides cancel, turns to one side add up.',
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
    driven_by: Literal['rate', 'side'] = 'rate'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', 'rad/s', prior_std=math.radians(1.0)),
        Coefficient('time_constant', 's', prior_std=20.0, prior_mean=20.0),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Contribution and its derivative (N, 2); remembers h and its derivative by tau."""
        k, tau = values[0], max(values[1], MIN_TIME_CONSTANT_S)
        h0, slope0 = memory if memory is not None else (0.0, 0.0)
        drive = self._drive(block.rate_rad_s[:, 2])
        # h stands at the ends of the intervals: h exp(t / tau) grows by the drive alone.
        ends_s = np.cumsum(block.dt_s)
        growth = np.exp(ends_s / tau)
        before = np.concatenate([[1.0], growth[:-1]])
        h = (h0 + np.cumsum(drive * (growth - before))) / growth
        h_before = np.concatenate([[h0], h[:-1]])
        slopes = (slope0 + np.cumsum((h_before - drive) * before * block.dt_s / tau**2)) / growth
        slopes_before = np.concatenate([[slope0], slopes[:-1]])
        middle = 0.5 * (h + h_before)
        by_values = np.stack([middle, 0.5 * k * (slopes + slopes_before)], axis=1)
        return GyroTerm(k * middle, by_values, memory=(h[-1], slopes[-1]))

    def _drive(self, rate_rad_s: Array) -> Array:
        if self.driven_by == 'rate':
            return rate_rad_s
        return np.sign(rate_rad_s) * (np.abs(rate_rad_s) > TURNING_RAD_S)
