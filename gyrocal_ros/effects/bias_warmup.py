"""The bias settles after power-on, as the part warms itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place, TypicalRange

MIN_TIME_CONSTANT_S = 1.0


@dataclass(frozen=True)
class BiasWarmup:
    """`-C exp(-t / tau)`: with the bias it makes B + C (1 - exp(-t / tau)) - C.

    The term vanishes long after power-on, so the bias keeps its meaning.
    Time starts at the first IMU sample.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='The part heats itself once it has power, and what it reads at rest creeps until it '
        'is as warm as it gets. That takes minutes and goes fast at first, then ever slower. A robot '
        'that takes its zero before the first drive carries the difference along as drift. The term '
        'vanishes long after power-on, so that the bias keeps its meaning.',
        equation='w = w_n - amplitude exp(-t / time_constant)',
        usual_size='0.05 to 2 deg/s, 100 to 1000 s',
        best_motion='rests spread over the first ten minutes after switching on',
        twins=('bias_temperature', 'bias'),
        source='Barshan and Durrant-Whyte 1995, Inertial navigation systems for mobile robots, IEEE '
        'Transactions on Robotics and Automation 11(3); Lee et al. 2012, eq. (8)',
        shows_in_any_turns=True,
        example=(math.radians(0.5), 300.0),
        shown_against='time',
    )
    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'bias_warmup'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'amplitude',
            'rad/s',
            prior_std=math.radians(1.0),
            typical=TypicalRange(math.radians(0.1), math.radians(2.0)),
        ),
        Coefficient(
            'time_constant',
            's',
            prior_std=200.0,
            prior_mean=300.0,
            scan=(40.0, 65.0, 105.0, 170.0, 275.0, 445.0, 720.0, 1160.0),
            typical=TypicalRange(100.0, 600.0, signed=False, is_strength=False),
        ),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution and its derivative (N, 2)."""
        amplitude, time_constant = values[0], max(values[1], MIN_TIME_CONSTANT_S)
        decay = np.exp(-block.time_s / time_constant)
        by_time_constant = -amplitude * decay * block.time_s / time_constant**2
        return GyroTerm(-amplitude * decay, np.stack([-decay, by_time_constant], axis=1))

    def columns_at(self, block: MotionBlock, scan: Array, memory: Memory) -> tuple[Array, Memory]:
        """Return the derivative (N, q) with respect to the amplitude at q time constants."""
        return -np.exp(-block.time_s[:, None] / scan), None
