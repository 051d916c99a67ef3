"""What a sensor model is made of: effects, each acting at one place, with coefficients to estimate.

An effect knows nothing of the filter. It is handed signals and coefficient values and returns its
contribution and the derivatives of it; the filter holds the coefficients as states.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount
from gyrocal_ros.model.bias import BiasModel

Place: TypeAlias = Literal['gyro', 'wheels', 'ground', 'camera', 'time']
"""Where an effect acts: the yaw rate, the distance by the wheels, a motion over the ground that no
sensor sees, the camera, or the stamps of the images."""

Memory: TypeAlias = Any
"""What an effect keeps from block to block; None where it needs nothing."""


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One number of an effect, with what is known of it before any measurement."""

    name: str
    unit: str
    prior_std: float
    prior_mean: float = 0.0
    walk: float = 0.0
    """Random walk, unit / sqrt(s); zero for a constant of the motion."""


class Effect(Protocol):
    """What every effect has."""

    @property
    def name(self) -> str:
        """Public name, as in `model.yaml` and in every report."""

    @property
    def acts_on(self) -> Place: ...

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """k coefficients."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroTerm:
    """What one effect adds to the yaw rate of a block of N intervals."""

    rate_rad_s: Array
    """(N,)"""
    by_values: Array
    """(N, k) derivative with respect to the effect's coefficients."""
    memory: Memory = None
    noise_rad_s: Array | None = None
    """(N,) standard deviation of what the effect cannot tell."""
    blind: Array | None = None
    """(N,) bool, where the reading says nothing of the rate: there neither scale factor nor bias nor
    other effects count, and reading plus `rate_rad_s` is all that is known."""


class GyroEffect(Effect, Protocol):
    """Adds to the yaw rate."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Contribution at the coefficient values (k,); `memory` is None at the first block."""


@runtime_checkable
class GyroEffectOnReadings(Protocol):
    """What a gyro effect has besides where its contribution does not tell what the sensor reads.

    The simulator solves `true rate = scale factor * nominal rate + bias + contributions` for the
    nominal rate. That fails where an effect loses information, as at a limit, or depends on the
    derivative of the rate; such an effect gives the readings itself.
    """

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Nominal yaw rate (n,) that is read where a sensor without the effect reads `nominal_rad_s`.

        Args:
            nominal_rad_s: (n,) what a sensor without the effect reads.
            dt_s: (n,) time from one reading to the next.
            values: (k,) coefficients.
            scale_factor: true rate over nominal rate.
        """


@runtime_checkable
class SignalEffect(Effect, Protocol):
    """An effect that follows a recorded signal."""

    @property
    def signal(self) -> str:
        """`temperature`, or a name as in `MotionBlock.covariates`."""


@runtime_checkable
class RelativeEffect(SignalEffect, Protocol):
    """An effect that counts from the mean of its signal over the recording."""

    def counted_from(self, reference: float) -> Effect:
        """The same effect with another reference."""


class WheelEffect(Effect, Protocol):
    """Corrects the distance that the wheels report."""

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Metres to add to each interval's distance (N,), and the derivative (N, k).

        The block's rates are true ones, as far as known, in place of nominal ones.
        """


class GroundEffect(Effect, Protocol):
    """Moves the robot over the ground as no sensor sees."""

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Displacement in the world over the block (3,), and the derivative (3, k).

        The block's rates are true ones, as far as known, in place of nominal ones.
        """


class CameraEffect(Effect, Protocol):
    """Corrects the camera's intrinsics or its mounting."""

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """The true camera, given the one that is believed."""

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Derivative (m, 2, k) of predicted pixels with respect to the coefficients."""


@runtime_checkable
class CameraEffectOnOdometry(Protocol):
    """What a camera effect has besides where the camera is right and the odometer's metre is wrong.

    The filter counts all lengths in the odometer's metres, so to it the camera sits elsewhere. To the
    simulator it sits where it should, and the wheels report other distances.
    """

    def odometry(self, distance_m: Array, values: Array) -> Array:
        """Distances (n,) by a right odometer, as they are reported at the coefficient values (k,)."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """What the derivative of a pixel by the camera's own parameters needs."""

    camera: CameraIntrinsics
    R_bc: Array
    p_bc: Array
    """Where the camera sits, corrected by all effects."""
    points_c: Array
    """(m, 3) in the optical frame, times `scale`."""
    scale: Array
    """(m,) inverse depth where the points carry it, else 1."""
    pixels: Array
    """(m, 2)"""
    by_point: Array
    """(m, 2, 3) derivative of the pixels by `points_c`."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The sensor model in use: a name, the bias, and the ordered effects."""

    name: str
    bias: BiasModel
    effects: tuple[Effect, ...]
    version: int = 1

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Every coefficient in the order of the filter's state."""
        return tuple(item for effect in self.effects for item in effect.coefficients)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names as reported: the effect's own, with the coefficient's behind it where it has several."""
        return tuple(name for effect in self.effects for name in coefficient_names(effect))


def signals_of(model: SensorModel) -> dict[str, list[str]]:
    """The recorded signals that effects of the model follow, each with the names of these effects."""
    followers: dict[str, list[str]] = {}
    for effect in model.effects:
        if isinstance(effect, SignalEffect):
            followers.setdefault(effect.signal, []).append(effect.name)
    return followers


def coefficient_names(effect: Effect) -> tuple[str, ...]:
    """Names of an effect's coefficients as reported."""
    if len(effect.coefficients) == 1:
        return (effect.name,)
    return tuple(f'{effect.name}.{item.name}' for item in effect.coefficients)


def placed(effects: tuple[Effect, ...], place: Place) -> list[tuple[Any, slice]]:
    """The effects that act at a place, each with where its coefficients stand among all."""
    found, start = [], 0
    for effect in effects:
        end = start + len(effect.coefficients)
        if effect.acts_on == place:
            found.append((effect, slice(start, end)))
        start = end
    return found
