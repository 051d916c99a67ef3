"""What an effect is made of, beyond its part in the filter: words for people, a form for the simulator."""

from __future__ import annotations

from abc import ABC, abstractmethod

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.gyro import Coefficient


class LinearEffect(ABC):
    """A gyro effect that is linear in its coefficients: a few columns of the paper's U."""

    name: str
    coefficients: tuple[Coefficient, ...]

    @abstractmethod
    def columns(self, block: MotionBlock) -> Array:
        """(N, k) contribution to the yaw rate, rad/s, per unit of each coefficient."""

    def correction(self, block: MotionBlock, values: Array) -> Array:
        """(N,) rad/s."""
        return self.columns(block) @ values

    def jacobian(self, block: MotionBlock, values: Array) -> Array:
        """(N, k)"""
        return self.columns(block)
