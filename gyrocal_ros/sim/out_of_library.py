"""Effects that the library lacks, to hide in recordings: they test what the diagnosis says of the unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.model.recording import SPEED_SIGNAL
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroTerm, Memory, Place, TypicalRange

VOLTAGE = 'battery_state.voltage'


class OutOfLibraryEffect(Effect, Protocol):
    """An effect that the library lacks, with the answers that are right."""

    @property
    def right_signal(self) -> str | None:
        """Signal that the unexplained structure goes with; None for a jump."""

    @property
    def right_effect(self) -> str | None:
        """Name of the effect of the library that explains most of it, if one does."""


@dataclass(frozen=True)
class Knock:
    """The bias jumps by `step` at `time`, as after a blow against a doorpost."""

    acts_on: ClassVar[Place] = 'gyro'
    right_signal: ClassVar[str | None] = None
    right_effect: ClassVar[str | None] = None
    name: str = 'stranger_knock'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'step',
            'rad/s',
            prior_std=math.radians(0.3),
            typical=TypicalRange(math.radians(0.05), math.radians(0.5)),
        ),
        Coefficient(
            'time',
            's',
            prior_std=0.0,
            prior_mean=150.0,
            typical=TypicalRange(0.25, 0.75, signed=False, is_strength=False, of_duration=True),
        ),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """`step` from `time` on."""
        after = (block.time_s >= values[1]).astype(float)
        return GyroTerm(values[0] * after, np.stack([after, np.zeros_like(after)], axis=1))


@dataclass(frozen=True)
class SpeedBias:
    """`k v`: the bias follows the speed of the wheels, as when their motors' field reaches the gyro."""

    acts_on: ClassVar[Place] = 'gyro'
    right_signal: ClassVar[str | None] = SPEED_SIGNAL
    right_effect: ClassVar[str | None] = covariate_bias(SPEED_SIGNAL).name
    name: str = 'stranger_speed_bias'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'k',
            'rad/s/(m/s)',
            prior_std=math.radians(1.0),
            typical=TypicalRange(math.radians(0.1), math.radians(2.0)),
        ),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """In proportion to the forward speed."""
        speed = block.distance_m / block.dt_s
        return GyroTerm(values[0] * speed, speed[:, None])


@dataclass(frozen=True)
class SupplyKink:
    """`k max(V0 - V, 0) w`: below a supply voltage V0 the scale factor drops."""

    acts_on: ClassVar[Place] = 'gyro'
    right_signal: ClassVar[str | None] = VOLTAGE
    right_effect: ClassVar[str | None] = covariate_scale(VOLTAGE).name
    name: str = 'stranger_supply_kink'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', '1/V', prior_std=0.1, typical=TypicalRange(0.03, 0.3)),
        Coefficient(
            'v0',
            'V',
            prior_std=0.0,
            prior_mean=16.0,
            typical=TypicalRange(16.07, 16.17, signed=False, is_strength=False),
        ),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """In proportion to the rate and to the missing voltage."""
        voltage = block.covariates.get(VOLTAGE, np.full(len(block.dt_s), np.inf))
        missing = np.maximum(values[1] - voltage, 0.0) * block.rate_rad_s[:, 2]
        return GyroTerm(values[0] * missing, np.stack([missing, np.zeros_like(missing)], axis=1))


OUT_OF_LIBRARY: dict[str, OutOfLibraryEffect] = {
    effect.name: effect for effect in (Knock(), SpeedBias(), SupplyKink())
}
