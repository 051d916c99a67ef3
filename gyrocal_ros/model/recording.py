"""Contents of a recording, as far as effects need to know them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gyrocal_ros.data import Array, IntArray, Rig

TEMPERATURE = 'temperature'
"""Name of the temperature signal; all other signals are named by topic and field."""

SPEED_SIGNAL = 'wheel_odometry.twist.twist.linear.x'
"""Name of the forward speed as a signal that effects may follow."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A recorded signal that an effect may follow."""

    name: str
    mean: float
    spread: float
    """Standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class GyroReadings:
    """The raw readings of the yaw rate."""

    t_ns: IntArray
    """(n,) stamps."""
    rate_rad_s: Array
    """(n,)"""


@dataclass(frozen=True, slots=True, eq=False)
class ImageTurns:
    """Turns of the image between consecutive images, by the features that both show."""

    start_ns: IntArray
    end_ns: IntArray
    """(m,) stamps of the two images."""
    turn_rad: Array
    """(m,) about the optical axis."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordingSummary:
    """Summary of a recording: its rig, duration, gyro readings and additional signals."""

    rig: Rig
    signals: tuple[Signal, ...]
    """Signals that vary, those left out not included."""
    left_out: tuple[str, ...]
    """Names of signals that vary but exceed the number that is tried."""
    recorded: frozenset[str]
    """Names of all recorded signals, constant ones and the temperature included."""
    duration_s: float
    readings: GyroReadings
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Range of each signal that varies and that a learned law may follow, by its name there."""
    image_turns: ImageTurns | None = None
    """None without images."""
    certain: frozenset[str] = frozenset()
    """Names of effects that the fit of a heading reference shows beyond doubt."""
