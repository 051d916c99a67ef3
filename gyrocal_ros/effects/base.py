"""Base of library effects: an explanation for people, and the common form of linear gyro effects."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, TypeAlias, TypeGuard, runtime_checkable

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroTerm, Memory, Place

Stimulus: TypeAlias = Literal[
    'rate',
    'slow rate',
    'turn',
    'time',
    'temperature',
    'force',
    'roll',
    'vibration',
    'distance',
    'heading',
    'place',
    'signal',
    'event',
    'image',
]
"""Quantity against which `sketch` shows an effect."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Description of an effect for people, with the properties that other rooms use."""

    physics: str
    """One paragraph that a technician understands."""
    equation: str
    usual_size: str
    best_motion: str
    """Motion that shows the effect best."""
    twins: tuple[str, ...] = ()
    """Effects that are easily confused with this one."""
    needs: tuple[str, ...] = ()
    """Signals, other than IMU, wheels and camera, without which the effect cannot be judged: `temperature`,
    or topic and field as `gyrocal check` lists them. An effect with an attribute `signal` needs that, too."""
    source: str = ''
    example: tuple[float, ...] = ()
    """Values of the coefficients, in their units, at which the effect is clearly visible."""
    shown_against: Stimulus = 'rate'
    """Quantity to vary in a sketch of the effect."""
    shows_in_any_turns: bool = False
    """True if every recording with turns can judge the effect."""
    may_break_the_filter: bool = False
    """True if the filter may diverge where a large effect of this kind is missing in the model."""
    disturbs: tuple[Place, ...] = ()
    """For what is no fault of a sensor: where effects act that cannot be judged while this explains more."""
    in_short: str = ''
    """The same in a few words, as the reason why an effect is not judged."""


@runtime_checkable
class LibraryEffect(Effect, Protocol):
    """An effect with an explanation."""

    @property
    def about(self) -> Explanation: ...


class LinearGyroEffect(ABC):
    """A gyro effect without memory that is linear in its coefficients: columns of the paper's U."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str
    coefficients: tuple[Coefficient, ...]

    @abstractmethod
    def columns(self, block: MotionBlock) -> Array:
        """Return the contribution (N, k) to the yaw rate, rad/s, per unit of each coefficient."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution at the coefficient values (k,)."""
        columns = self.columns(block)
        return GyroTerm(columns.dot(values), columns)


def is_linear(effect: Effect) -> TypeGuard[LinearGyroEffect]:
    """Return True for a gyro effect whose contribution is that of its columns, and nothing else."""
    return getattr(type(effect), 'contribute', None) is LinearGyroEffect.contribute


class LinearMemoryEffect(ABC):
    """A gyro effect with a memory of its own that is linear in its coefficients."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str
    coefficients: tuple[Coefficient, ...]

    @abstractmethod
    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the contribution (N, k) to the yaw rate, rad/s, per unit of each coefficient.

        The memory is None at the first block; the new one comes second.
        """

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution at the coefficient values (k,)."""
        columns, memory = self.remembered(block, memory)
        return GyroTerm(columns.dot(values), columns, memory)


def column(*signals: Array) -> Array:
    """Return signals (N,) as the columns (N, k) of a linear effect: a copy, which may be changed."""
    return np.array(signals).T


def recorded(signal: Array) -> Array:
    """Return a signal with zero where it was not recorded (NaN): the effect then contributes nothing."""
    return np.where(np.isnan(signal), 0.0, signal)


def with_unit(value: float, unit: str, digits: int = 4) -> str:
    """Format a number for people: without the unit 1, and angles in degrees."""
    shown, factor = shown_in(unit)
    return f'{factor * value:.{digits}g} {shown}'.removesuffix(' 1')


def shown_in(unit: str) -> tuple[str, float]:
    """Return the unit in which results show a coefficient, and the factor to it: degrees in place of rad."""
    return (unit.replace('rad', 'deg', 1), math.degrees(1.0)) if unit.startswith('rad') else (unit, 1.0)
