"""The receive path of the board: bytes and arrival times to stamped readings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from gyrocal_ros.board.clock import Clock, Stamp
from gyrocal_ros.board.convert import (
    MAX_INTERVAL_S,
    US_PER_S,
    SupplySample,
    WheelReading,
    imu_sample,
    supply_sample,
    temperature_sample,
    wheel_sample,
    wheel_step,
)
from gyrocal_ros.board.messages import Acknowledgement, Imu, Message, Supply, Wheels
from gyrocal_ros.board.protocol import TIME_WRAP, Decoder, Packet, wire_time_s
from gyrocal_ros.config.board_limits import BoardLimits
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import NS_PER_S, ImuSample, TemperatureSample, WheelSample, nanoseconds

TEMPERATURE_PERIOD_NS = NS_PER_S
"""Output interval of the temperature, which every IMU message contains."""


@dataclass(frozen=True, slots=True)
class WheelPose:
    """Pose from wheel odometry alone, relative to the start."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    travelled_m: float = 0.0
    turned_rad: float = 0.0
    """Sums of the absolute distances and turns."""

    def advanced(self, distance_m: float, turned_rad: float) -> WheelPose:
        """Return the pose after a step that is short enough to be nearly straight."""
        heading = self.yaw_rad + turned_rad / 2.0
        return WheelPose(
            self.x_m + distance_m * math.cos(heading),
            self.y_m + distance_m * math.sin(heading),
            math.remainder(self.yaw_rad + turned_rad, math.tau),
            self.travelled_m + abs(distance_m),
            self.turned_rad + abs(turned_rad),
        )


@dataclass(frozen=True, slots=True)
class WheelMotion:
    """Wheel motion and the odometry pose after it."""

    sample: WheelSample
    pose: WheelPose


Reading: TypeAlias = ImuSample | TemperatureSample | WheelMotion | SupplySample | Acknowledgement


class BoardReader:
    """Converts received bytes to readings, in the order of their stamps.

    It exists as long as the program: stamps continue to increase after the line was lost and found
    again, and after a restart of the board. No input raises an error.

    Args:
        config: meaning of one count of each converter.
        baud_rate: speed of the line; it determines the transmission time of a frame, which arrivals do
            not reveal.
        limits: largest readings; None for the default ones.
    """

    def __init__(self, config: BoardConfig, baud_rate: int, limits: BoardLimits | None = None) -> None:
        self.decoder = Decoder()
        self.clock = Clock()
        self.received: Counter[type[Message]] = Counter()
        """Number of packets received, by message type."""
        self.bytes = 0
        self.implausible = 0
        """Number of packets dropped because their contents exceed the limits."""
        self._config, self._limits = config, limits or BoardLimits()
        self._wire_ns = {
            kind: nanoseconds(wire_time_s(kind, baud_rate)) for kind in (Imu, Wheels, Supply, Acknowledgement)
        }
        self._temperature_ns: int | None = None
        self._wheels: WheelReading | None = None
        self._pose = WheelPose()

    def feed(self, data: bytes, arrival_ns: int) -> list[Reading]:
        """Process the next bytes of the line.

        Args:
            data: any number of bytes.
            arrival_ns: arrival time of the last of them on the host clock that the stamps follow.
        """
        self.bytes += len(data)
        return [
            reading for packet in self.decoder.feed(data) for reading in self._readings(packet, arrival_ns)
        ]

    def skip_partial_frame(self) -> None:
        """Start on a line, the first or another one, on which a partial frame may come first."""
        self.decoder.skip_partial_frame()

    def _readings(self, packet: Packet, arrival_ns: int) -> Iterator[Reading]:
        message = packet.message
        self.received[type(message)] += 1
        if isinstance(message, Acknowledgement):
            yield message
        elif isinstance(message, Imu | Wheels | Supply):
            stamp = self.clock.stamp(packet.time_us, arrival_ns - self._wire_ns[type(message)])
            if stamp is not None:
                yield from self._stamped(message, stamp, packet.time_us)

    def _stamped(self, message: Imu | Wheels | Supply, stamp: Stamp, time_us: int) -> Iterator[Reading]:
        if isinstance(message, Imu):
            sample = imu_sample(message, stamp.t_ns, self._config)
            if not self._is_plausible(sample):
                self.implausible += 1
                return
            yield sample
            if self._temperature_is_due(stamp.t_ns):
                yield temperature_sample(message, stamp.t_ns, self._config)
        elif isinstance(message, Wheels):
            yield from self._wheel_motion(WheelReading(stamp, time_us, message))
        else:
            yield supply_sample(message, stamp.t_ns)

    def _is_plausible(self, sample: ImuSample) -> bool:
        max_rate = math.radians(self._limits.rate_deg_s)
        return (
            max(map(abs, sample.rate_rad_s)) <= max_rate
            and max(map(abs, sample.specific_force_m_s2)) <= self._limits.force_m_s2
        )

    def _is_possible(self, before: WheelReading, after: WheelReading) -> bool:
        """Return True if the wheels can have turned from one reading to the next."""
        duration_s = (after.time_us - before.time_us) % TIME_WRAP / US_PER_S
        distance_m, turned_rad = wheel_step(before, after, self._config)
        max_m = self._limits.speed_m_s * duration_s + self._config.tick_m  # one tick may come at any time
        tick_rad = self._config.tick_m / self._config.track_m
        max_rad = math.radians(self._limits.turn_rate_deg_s) * duration_s + tick_rad
        return abs(distance_m) <= max_m and abs(turned_rad) <= max_rad

    def _temperature_is_due(self, t_ns: int) -> bool:
        last_ns = self._temperature_ns
        is_due = last_ns is None or abs(t_ns - last_ns) >= TEMPERATURE_PERIOD_NS
        if is_due:
            self._temperature_ns = t_ns
        return is_due

    def _wheel_motion(self, after: WheelReading) -> Iterator[WheelMotion]:
        before = self._wheels
        if before is not None and not self._is_possible(before, after):
            self.implausible += 1
            if (after.time_us - before.time_us) % TIME_WRAP <= MAX_INTERVAL_S * US_PER_S:
                return  # the next packet is compared with the last good one
            before = None  # the counters have jumped for good
        self._wheels = after
        if before is None:
            return
        self._pose = self._pose.advanced(*wheel_step(before, after, self._config))
        sample = wheel_sample(before, after, self._config)
        if sample is not None:
            yield WheelMotion(sample, self._pose)
