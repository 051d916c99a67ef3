"""The values exchanged between the rooms: frozen dataclasses, SI units, integer nanoseconds.

A source yields `Measurement`s in the order of their stamps; the filter processes one at a time; all
later stages read a finished `Run` (see `pipeline.calibrate`).

Frames follow REP 103 and REP 105: `w` is the map, `b` the robot body (x forward, y left, z up), `c` the
optical frame of the ceiling camera (z along the optical axis, x right and y down in the image). `R_ab`
rotates coordinates from b to a; `p_ab` is the origin of b in coordinates of a.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.kernels import compiled

Array: TypeAlias = NDArray[np.floating[Any]]  # float64; the stubs of numpy.linalg promise no more
IntArray: TypeAlias = NDArray[np.int64]

NS_PER_S = 1_000_000_000
STANDARD_GRAVITY_M_S2 = 9.80665


def seconds(t_ns: int) -> float:
    """Convert a duration in nanoseconds to seconds."""
    return t_ns / NS_PER_S


def nanoseconds(t_s: float) -> int:
    """Convert a duration in seconds to nanoseconds, rounded to the nearest."""
    return round(t_s * NS_PER_S)


def constant(value: float, count: int) -> Array:
    """Return an array (count,) of equal values; for short ones `numpy.full` takes four times as long."""
    values = np.empty(count)
    values.fill(value)
    return values


T = TypeVar('T')


@compiled
def changed(item: T, /, **values: Any) -> T:
    """Return a copy of a frozen dataclass with slots where some fields have other values.

    As `dataclasses.replace`, which it is where the kernels were not built, for the steps of the filter:
    `__post_init__` does not run.

    Raises:
        TypeError: one of the names is not that of a field.
    """
    return replace(item, **values)  # type: ignore[type-var]


@compiled
def quickly_filled(cls: type[T]) -> type[T]:
    """Let a frozen dataclass with slots take its values in less time, where the kernels were built.

    Its own `__init__` writes field by field through the interpreter; the steps of the filter make dozens of
    such objects. `__post_init__` does not run.
    """
    return cls


# --- measurements -------------------------------------------------------------------------------


@quickly_filled
@dataclass(frozen=True, slots=True)
class ImuSample:
    """One IMU reading in body axes, with the nominal scale factor and bias already applied."""

    t_ns: int
    """Time of measurement."""
    rate_rad_s: tuple[float, float, float]
    """Body rates about x, y, z."""
    specific_force_m_s2: tuple[float, float, float]
    """Accelerometer reading along x, y, z: (0, 0, +9.8) when level and at rest."""


@quickly_filled
@dataclass(frozen=True, slots=True)
class WheelSample:
    """Mean motion from the wheel encoders over the interval that ends at the stamp."""

    t_ns: int
    speed_m_s: float
    """Forward speed."""
    yaw_rate_rad_s: float
    """Yaw rate from the difference of the wheels; too coarse for calibration."""


@quickly_filled
@dataclass(frozen=True, slots=True)
class TemperatureSample:
    """Temperature of the gyro die or its board."""

    t_ns: int
    temperature_c: float


@quickly_filled
@dataclass(frozen=True, slots=True)
class CovariateSample:
    """Any other recorded signal, a candidate explanation of residuals."""

    t_ns: int
    name: str
    """Topic and field, for example `battery_state.current`."""
    value: float


@dataclass(frozen=True, slots=True)
class HeadingSample:
    """Heading from an external reference (visual odometry, laser), in its own frame."""

    t_ns: int
    yaw_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of the ceiling camera, stamped at the middle of its exposure."""

    t_ns: int
    image: NDArray[np.uint8]
    """(height, width) grey values."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class FeatureObservations:
    """Features found by the tracker in one image; empty if there are none."""

    t_ns: int
    ids: IntArray
    """(n,) identities; an id is not reused after its feature is dropped."""
    pixels: Array
    """(n, 2) raw, distorted pixels (u, v); the centre of the top-left pixel is (0, 0)."""
    covariances_px2: Array | None = None
    """(n, 2, 2) covariances of their errors by the tracker; None if it does not tell."""
    on_lens: int = 0
    """Number of features dropped because they stay in the image while the camera turns."""

    def __getitem__(self, chosen: IntArray) -> FeatureObservations:
        covariances = None if self.covariances_px2 is None else self.covariances_px2[chosen]
        pixels = self.pixels[chosen]
        return FeatureObservations(self.t_ns, self.ids[chosen], pixels, covariances, self.on_lens)


@quickly_filled
@dataclass(frozen=True, slots=True)
class TruthSample:
    """Pose from an external reference, used only for comparison, never for estimation."""

    t_ns: int
    position_m: tuple[float, float, float]
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A permanent step of the clock of the stamps; later stamps have a new time base."""

    t_ns: int
    """First stamp on the new time base."""
    step_ns: int
    """Size of the jump, new minus old."""


Measurement: TypeAlias = (
    ImuSample
    | WheelSample
    | TemperatureSample
    | CovariateSample
    | HeadingSample
    | Frame
    | FeatureObservations
    | TruthSample
    | ClockStep
)


@dataclass(frozen=True, slots=True, eq=False)
class SearchRegions:
    """Predicted positions of the filter's features in the next image."""

    t_ns: int
    ids: IntArray
    """(n,) identities."""
    pixels: Array
    """(n, 2) predicted raw pixels (u, v)."""
    covariances_px2: Array
    """(n, 2, 2) covariances of the innovation, including the pixel noise."""


# --- immediate outputs ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedSample:
    """One IMU reading after calibration, in body axes."""

    t_ns: int
    rate_rad_s: tuple[float, float, float]
    rate_variances: tuple[float, float, float]
    """rad^2/s^2, of the single sample: noise, bias and coefficients."""
    specific_force_m_s2: tuple[float, float, float]
    euler_rad: tuple[float, float, float]
    """Roll, pitch and yaw of the body in the map."""
    euler_covariance: Array
    """(3, 3) covariance of the Euler angles."""


@dataclass(frozen=True, slots=True, eq=False)
class OdometryEstimate:
    """Pose of the robot in the map, and its velocity."""

    t_ns: int
    position_m: tuple[float, float, float]
    euler_rad: tuple[float, float, float]
    pose_covariance: Array
    """(6, 6) covariance of position and Euler angles."""
    speed_m_s: float
    """Speed along body x."""
    speed_variances: tuple[float, float, float]
    """m^2/s^2, along body x, y, z."""
    rate_rad_s: tuple[float, float, float]
    rate_variances: tuple[float, float, float]


# --- geometry of the robot ----------------------------------------------------------------------


Lens: TypeAlias = Literal['plumb_bob', 'rational_polynomial', 'equidistant']
"""Name of a lens model in CameraInfo."""


@dataclass(frozen=True, slots=True)
class CameraIntrinsics:
    """Pinhole camera with a lens, as in sensor_msgs/CameraInfo."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """`plumb_bob`: k1, k2, p1, p2, k3; `rational_polynomial`: these, k4, k5, k6; `equidistant`: k1 to k4."""
    lens: Lens = 'plumb_bob'


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Pose of a sensor on the robot body: `p_b = R_bs p_s + p_bs`."""

    R_bs: Array
    """(3, 3) rotation from sensor to body axes."""
    p_bs: Array
    """(3,) m, origin of the sensor frame in body axes."""
    shift: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) m, part of `p_bs` by which an effect has moved the sensor from where it is said to be."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The fixed geometry of one robot."""

    camera: CameraIntrinsics | None
    """Intrinsics of the ceiling camera; None if none is in use."""
    camera_mount: Mount


@dataclass(frozen=True, slots=True)
class Span:
    """A time interval including both ends."""

    start_ns: int
    end_ns: int

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return seconds(self.end_ns - self.start_ns)


class Source(Protocol):
    """A source of measurements: a bag, the simulator, or the robot itself."""

    @property
    def name(self) -> str:
        """Name for display: a path or a scenario."""

    @property
    def rig(self) -> Rig:
        """Geometry of the robot during the measurements."""

    @property
    def span(self) -> Span:
        """First and last time, for the progress bar."""

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements in the order of their stamps; may be called again."""


# --- motion between two camera frames -------------------------------------------------------------


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class MotionBlock:
    """Measurements of the IMU and the wheels between two times, divided into N short intervals.

    The filter predicts over one block at a time; effects read the signals they need as columns.
    """

    start_ns: int
    end_ns: int
    time_s: Array
    """(N,) middle of each interval, seconds since the first IMU sample."""
    dt_s: Array
    """(N,) length of each interval."""
    rate_rad_s: Array
    """(N, 3) nominal body rates, mean over each interval."""
    yaw_acceleration_rad_s2: Array
    """(N,) change of the nominal yaw rate over each interval."""
    specific_force_m_s2: Array
    """(N, 3) mean over each interval."""
    vibration_m2_s4: Array
    """(N,) recent variance of the detrended specific force, summed over all axes."""
    distance_m: Array
    """(N,) distance from the wheels; zeros if there are no encoders."""
    wheel_turn_rad: Array
    """(N,) turn from the difference of the wheels; zeros if there are no encoders."""
    temperature_c: Array
    """(N,) NaN if it is not recorded."""
    covariates: dict[str, Array] = field(default_factory=dict)
    """Recorded signals: name to (N,) values."""
    gap_s: float = 0.0
    """Time in this block not covered by IMU samples."""
    wheel_gap_s: float = 0.0
    """Time in this block not covered by encoder readings."""
    wheels_at_rest: bool = False
    """True if every encoder reading that overlaps the block is zero."""
    heading_rad: Array | None = None
    """(N,) heading in the map by the filter; None where there is no filter."""
    position_m: Array | None = None
    """(N, 2) position in the map by the filter; None where there is no filter."""
    bias_rad_s: float = 0.0
    """Bias of the yaw rate by the filter; zero where there is no filter."""

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return seconds(self.end_ns - self.start_ns)

    def way_and_turn(self) -> tuple[float, float, float, float]:
        """Return the sums of the ways (m) and of the turns (rad), and of the sizes of both."""
        return way_and_turn(self.rate_rad_s, self.dt_s, self.distance_m)

    def part(self, chosen: slice) -> MotionBlock:
        """Return a block with some of the intervals; fields of the whole block are unchanged."""
        columns = {item.name: getattr(self, item.name) for item in fields(self)}
        cut: dict[str, Any] = {
            name: column[chosen] for name, column in columns.items() if isinstance(column, np.ndarray)
        }
        return replace(self, covariates={name: c[chosen] for name, c in self.covariates.items()}, **cut)


@compiled
def way_and_turn(rate_rad_s: Array, dt_s: Array, distance_m: Array) -> tuple[float, float, float, float]:
    """Return the sums of the ways (m) and of the turns (rad) of N intervals, and of the sizes of both.

    Args:
        rate_rad_s: (N, 3)
        dt_s: (N,)
        distance_m: (N,)
    """
    turns_rad = rate_rad_s[:, 2] * dt_s
    sums = distance_m.sum(), turns_rad.sum(), np.abs(distance_m).sum(), np.abs(turns_rad).sum()
    way_m, turn_rad, whole_way_m, whole_turn_rad = map(float, sums)
    return way_m, turn_rad, whole_way_m, whole_turn_rad
