"""Parts of a sensor model: effects, each acting at one place, with coefficients to estimate.

An effect does not depend on the filter. It takes signals and coefficient values and returns its contribution
and the derivatives of that; the filter holds the coefficients as states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias, TypeVar, runtime_checkable

from gyrocal_ros.data import Array, CameraIntrinsics, MotionBlock, Mount, quickly_filled
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.recording import GyroReadings, RecordingSummary

Place: TypeAlias = Literal['gyro', 'wheels', 'ground', 'camera', 'time', 'shutter', 'noise']
"""Place where an effect acts: the yaw rate, the distance by the wheels, a motion over the ground that no
sensor measures, the camera, the stamps of the images, the times of exposure of their rows, or the noise of
the yaw rate."""

Memory: TypeAlias = Any
"""State of an effect that is passed from block to block; None where it needs none."""


@dataclass(frozen=True, slots=True)
class TypicalRange:
    """Values of a coefficient that real sensors show; simulated hidden effects are drawn from it."""

    low: float
    """Value that is just visible in a recording of five minutes with turns of several speeds."""
    high: float
    """Large value. Smaller than `low` where a smaller value does more, as for a saturation limit."""
    signed: bool = True
    """True if both signs occur."""
    is_strength: bool = True
    """True if the value says how strong the effect is; False for a time constant or a threshold."""
    of_duration: bool = False
    """True if the values are fractions of the duration of the recording, in s."""

    def value(self, size: float) -> float:
        """Return the value for a size between 0 (`low`) and 1 (`high`), geometrically interpolated."""
        return self.low * (self.high / self.low) ** size


@dataclass(frozen=True, slots=True)
class Coefficient:
    """One number of an effect, with its prior."""

    name: str
    unit: str
    prior_std: float
    """Prior standard deviation; zero for a limit, which is detected in the readings, not estimated."""
    prior_mean: float = 0.0
    walk: float = 0.0
    """Random walk, unit / sqrt(s); zero for a constant of the motion."""
    scan: tuple[float, ...] = ()
    """Values at which the diagnosis tries a coefficient that the effect does not depend on linearly, such
    as a time constant: an increasing geometric series. One coefficient of an effect may have a scan; the
    effect has to vanish where all others are zero."""
    typical: TypicalRange | None = None
    """Values that occur; None keeps the effect out of recordings with randomly hidden effects."""


MAX_VALUE, MAX_TIME_S = 1e9, 1e4
"""Largest value of a coefficient, in its unit, and of one that is a time."""


def is_possible(item: Coefficient, value: float) -> bool:
    """Return True if a coefficient can have a value: no time constant and no density is negative."""
    if item.scan and value < 0.0:
        return False
    return abs(value) <= (MAX_TIME_S if item.unit == 's' else MAX_VALUE)


class Effect(Protocol):
    """A physical effect."""

    @property
    def name(self) -> str:
        """Public name, as in `model.yaml` and in every report."""

    @property
    def acts_on(self) -> Place: ...

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """k coefficients."""


E = TypeVar('E', bound=Effect)


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class GyroTerm:
    """Contribution of one effect to the yaw rate of a block of N intervals."""

    rate_rad_s: Array
    """(N,)"""
    by_values: Array
    """(N, k) derivative with respect to the effect's coefficients."""
    memory: Memory = None
    noise_rad_s: Array | None = None
    """(N,) standard deviation of the rate where the effect leaves it unknown."""
    blind: Array | None = None
    """(N,) bool, True where the reading does not depend on the rate: there neither scale factor nor bias nor
    other effects act, and the estimate of the rate is the reading plus `rate_rad_s`."""


class GyroEffect(Effect, Protocol):
    """Adds to the yaw rate."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the contribution at the coefficient values (k,); `memory` is None at the first block."""


@runtime_checkable
class GyroEffectOnReadings(Protocol):
    """Optional part of a gyro effect whose contribution does not determine the reading.

    The simulator solves `true rate = scale factor * nominal rate + bias + contributions` for the nominal
    rate. That fails where an effect loses information, as at a limit, or depends on the derivative of the
    rate; such an effect returns the readings itself.
    """

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Return the nominal yaw rate (n,) that a sensor with the effect reads.

        Args:
            nominal_rad_s: (n,) readings of a sensor without the effect.
            dt_s: (n,) time from one reading to the next.
            values: (k,) coefficients.
            scale_factor: true rate over nominal rate.
        """


@runtime_checkable
class RelativeEffect(Effect, Protocol):
    """An effect that follows a recorded signal, relative to the mean of the signal over the recording."""

    @property
    def signal(self) -> str:
        """Name of the signal, as in `MotionBlock.covariates`."""

    def counted_from(self, reference: float) -> Effect:
        """Return the same effect with another reference."""


@dataclass(frozen=True, slots=True)
class DetectedLimit:
    """A limit that the readings show."""

    value: float
    """Value of the effect's only coefficient."""
    is_certain: bool
    """True if the readings alone prove the limit; False if the headings have to confirm it."""


@runtime_checkable
class LimitEffect(Protocol):
    """Optional part of a gyro effect that loses information beyond or below a limit.

    Nothing depends smoothly on a limit, so it is not estimated: it is detected in the readings, and a run
    of the filter with it decides. Its coefficient has `prior_std` 0; where noise may hide the limit, the
    `scan` of the coefficient holds the values to try.
    """

    def detect(self, readings: GyroReadings) -> DetectedLimit | None:
        """Find the limit in the readings; None where they show none."""

    def rate_error(self, rate_rad_s: Array, limit: float) -> tuple[Array, Array]:
        """Return the error of the rate that a filter without the effect makes if the limit is real.

        Args:
            rate_rad_s: (n,) readings.
            limit: value of the limit.

        Returns:
            The error (n,) but for a positive factor, and the part (n,) of the bias that is wrongly added.
        """

    def is_plausible(self, readings: GyroReadings, limit: float) -> bool:
        """Return False if the readings contradict the limit."""


@runtime_checkable
class LimitOfEachSide(Protocol):
    """Optional part of a limit of the rate whose two sides may have limits of their own."""

    def of_each_side(self, readings: GyroReadings) -> Effect | None:
        """Find a limit of each side; None where the readings show the same for both, or not for both."""


@runtime_checkable
class MovesAgainstBody(Protocol):
    """Optional part of an effect by which the camera, and the map with it, turns against the robot's body."""

    def turn_against_body_rad(self, values: Array) -> float:
        """Return the largest change of the angle between both at the coefficient values (k,)."""


@runtime_checkable
class ScannedColumns(Protocol):
    """Optional part of a gyro effect with a scan: all values of the scan at once, for speed."""

    def columns_at(self, block: MotionBlock, scan: Array, memory: Memory) -> tuple[Array, Memory]:
        """Return the derivative with respect to the other coefficients, at zero, and the new memory.

        Args:
            block: N intervals.
            scan: (q,) values of the scanned coefficient.
            memory: what the last call returned; None at the first block.

        Returns:
            (N, q s) for s other coefficients, those of the first value first, and the memory.
        """


@runtime_checkable
class EffectWithForms(Protocol):
    """Optional part of an effect that comes in several forms, of which the diagnosis takes the best."""

    def forms(self) -> tuple[Effect, ...]:
        """Return the same effect in each of its forms."""


@runtime_checkable
class ConditionallyObservable(Protocol):
    """Optional part of an effect that not every recording with the required signals can show."""

    def unobservable(self, recording: RecordingSummary) -> str:
        """Return why the recording cannot show the effect; empty if it can."""


class WheelEffect(Effect, Protocol):
    """Corrects the distance that the wheels report."""

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Return the metres to add to the distance of each interval (N,), and the derivative (N, k).

        The rates of the block are estimates of the true ones in place of nominal ones.
        """


class GroundEffect(Effect, Protocol):
    """Moves the robot over the ground without any sensor measuring it."""

    def contribute(self, block: MotionBlock, values: Array) -> tuple[Array, Array]:
        """Return the displacement in the world over the block (3,), and the derivative (3, k).

        The rates of the block are estimates of the true ones in place of nominal ones.
        """


class CameraEffect(Effect, Protocol):
    """Corrects the camera's intrinsics or its mounting."""

    def corrected(
        self, camera: CameraIntrinsics, mount: Mount, values: Array
    ) -> tuple[CameraIntrinsics, Mount]:
        """Return the true camera and mounting, given the assumed ones."""

    def pixels_by_values(self, seen: SeenPoints, values: Array) -> Array:
        """Return the derivative (m, 2, k) of predicted pixels with respect to the coefficients."""


@runtime_checkable
class RotatesCamera(Protocol):
    """Optional part of a camera effect that turns the camera against the gyros.

    A turn on the spot shows it, whatever the depth of the features; others need the camera to move.
    """

    @property
    def rotates_camera(self) -> bool: ...


class ShutterEffect(Effect, Protocol):
    """Lets the rows of an image be exposed one after the other, at a constant pace about the stamp."""

    def readout_s(self, values: Array) -> tuple[float, Array]:
        """Return the time from the upper edge of the image to the lower one, and the derivative (k,)."""


class NoiseEffect(Effect, Protocol):
    """Makes the yaw rate noisier than the settings say.

    The filter does not estimate noise: its coefficient has `prior_std` 0, and the diagnosis tries the `scan`.
    """

    def density(self, rate_rad_s: Array, values: Array) -> Array:
        """Return the density of the added white noise (N,), rad/s/sqrt(Hz), at readings of the rate (N,)."""

    def bias_walk(self, values: Array) -> float:
        """Return the added random walk of the bias, rad/s/sqrt(s)."""


@runtime_checkable
class CameraEffectOnOdometry(Protocol):
    """Optional part of a camera effect whose physical cause is the length unit of the odometer.

    The filter expresses all lengths in metres of the odometer, so the effect changes the position of the
    camera there. In the simulator the camera has its nominal position, and the wheels report other distances.
    """

    def odometry(self, distance_m: Array, values: Array) -> Array:
        """Return true distances (n,) as the wheels report them at the coefficient values (k,)."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """Inputs of the derivative of pixels with respect to parameters of the camera."""

    camera: CameraIntrinsics
    R_bc: Array
    p_bc: Array
    shift: Array
    """Mounting of the camera, corrected by all effects; see `Mount`."""
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
        """Names as reported: that of the effect, followed by that of the coefficient where it has several."""
        return tuple(name for effect in self.effects for name in coefficient_names(effect))


def coefficient_names(effect: Effect) -> tuple[str, ...]:
    """Return the names of the coefficients of an effect as reported."""
    if len(effect.coefficients) == 1:
        return (effect.name,)
    return tuple(f'{effect.name}.{item.name}' for item in effect.coefficients)


def placed(effects: tuple[Effect, ...], place: Place) -> list[tuple[Any, slice]]:
    """Return the effects that act at a place, each with the slice of its coefficients among all."""
    found, start = [], 0
    for effect in effects:
        end = start + len(effect.coefficients)
        if effect.acts_on == place:
            found.append((effect, slice(start, end)))
        start = end
    return found


def with_means(effect: E, values: Sequence[float]) -> E:
    """Return the effect with other prior means; the prior standard deviations stay."""
    items = zip(effect.coefficients, values, strict=True)
    moved = tuple(replace(item, prior_mean=float(value)) for item, value in items)
    return replace(effect, coefficients=moved)  # type: ignore[type-var,no-any-return]
