"""Effects that the library does not have, to hide in recordings: what then is said of the unknown?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroTerm, Memory, Place

VOLTAGE = 'battery_state.voltage'


@dataclass(frozen=True)
class Knock:
    """The bias jumps by `step` at `time`, as after a blow against a doorpost."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'stranger_knock'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('step', 'rad/s', prior_std=math.radians(0.3)),
        Coefficient('time', 's', prior_std=0.0, prior_mean=150.0),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """`step` from `time` on."""
        after = (block.time_s >= values[1]).astype(float)
        return GyroTerm(values[0] * after, np.stack([after, np.zeros_like(after)], axis=1))


@dataclass(frozen=True)
class SpeedBias:
    """`k v`: the bias follows the speed of the wheels, as when their motors' field reaches the gyro."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'stranger_speed_bias'
    coefficients: tuple[Coefficient, ...] = (Coefficient('k', 'rad/s/(m/s)', prior_std=math.radians(1.0)),)

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """In proportion to the speed forward."""
        speed = block.distance_m / block.dt_s
        return GyroTerm(values[0] * speed, speed[:, None])


@dataclass(frozen=True)
class SupplyKink:
    """`k max(V0 - V, 0) w`: below a supply voltage V0 the scale factor gives way."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'stranger_supply_kink'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', '1/V', prior_std=0.1),
        Coefficient('v0', 'V', prior_std=0.0, prior_mean=16.0),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """In proportion to the rate and to the voltage that lacks."""
        voltage = block.covariates.get(VOLTAGE, np.full(len(block.dt_s), np.inf))
        lacking = np.maximum(values[1] - voltage, 0.0) * block.rate_rad_s[:, 2]
        return GyroTerm(values[0] * lacking, np.stack([lacking, np.zeros_like(lacking)], axis=1))


STRANGERS: dict[str, Effect] = {effect.name: effect for effect in (Knock(), SpeedBias(), SupplyKink())}
