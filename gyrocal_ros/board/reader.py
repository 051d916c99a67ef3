"""All that comes from the board becomes readings with stamps: bytes and their arrival go in."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from gyrocal_ros.board.clock import Clock, Stamp
from gyrocal_ros.board.convert import (
    SupplySample,
    WheelReading,
    imu_sample,
    supply_sample,
    temperature_sample,
    wheel_sample,
    wheel_step,
)
from gyrocal_ros.board.messages import Acknowledgement, Imu, Message, Supply, Wheels
from gyrocal_ros.board.protocol import Decoder, Packet, wire_s
from gyrocal_ros.config.sections import BoardConfig
from gyrocal_ros.data import NS_PER_S, ImuSample, TemperatureSample, WheelSample, nanoseconds

TEMPERATURE_PERIOD_NS = NS_PER_S
"""The temperature comes with every IMU message and is handed on so often."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the wheels alone say that the robot is, seen from where it was at the start."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def moved(self, distance_m: float, turned_rad: float) -> Pose:
        """Go on by a step that is so short that it is about straight."""
        heading = self.yaw_rad + turned_rad / 2.0
        return Pose(
            self.x_m + distance_m * math.cos(heading),
            self.y_m + distance_m * math.sin(heading),
            math.remainder(self.yaw_rad + turned_rad, math.tau),
        )


@dataclass(frozen=True, slots=True)
class WheelMotion:
    """How the wheels turn, and where that has brought the robot."""

    sample: WheelSample
    pose: Pose


Reading: TypeAlias = ImuSample | TemperatureSample | WheelMotion | SupplySample | Acknowledgement


class BoardReader:
    """Makes readings of what comes in, in the order of their stamps.

    It lives as long as the program: stamps go on to rise when the line was lost and found again, and
    when the board was started anew. Nothing that comes in raises an error.

    Args:
        config: what one count of each converter means.
        baud_rate: speed of the line. What a frame takes on the wire no arrival can tell.
    """

    def __init__(self, config: BoardConfig, baud_rate: int) -> None:
        self.decoder = Decoder()
        self.clock = Clock()
        self.received: Counter[type[Message]] = Counter()
        """Packets handed on, by their message."""
        self.bytes = 0
        self._config = config
        self._wire_ns = {
            kind: nanoseconds(wire_s(kind, baud_rate)) for kind in (Imu, Wheels, Supply, Acknowledgement)
        }
        self._temperature_ns: int | None = None
        self._wheels: WheelReading | None = None
        self._pose = Pose()

    def take(self, data: bytes, arrival_ns: int) -> list[Reading]:
        """Take the next bytes of the line.

        Args:
            data: as many as there are.
            arrival_ns: when the last of them arrived, by the clock that the stamps are to follow.
        """
        self.bytes += len(data)
        return [
            reading for packet in self.decoder.feed(data) for reading in self._readings(packet, arrival_ns)
        ]

    def join(self) -> None:
        """Begin to listen to a line, the first one or another one."""
        self.decoder.join()

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
            yield imu_sample(message, stamp.t_ns, self._config)
            if self._temperature_is_due(stamp.t_ns):
                yield temperature_sample(message, stamp.t_ns, self._config)
        elif isinstance(message, Wheels):
            yield from self._moved(WheelReading(stamp, time_us, message))
        else:
            yield supply_sample(message, stamp.t_ns)

    def _temperature_is_due(self, t_ns: int) -> bool:
        last_ns = self._temperature_ns
        is_due = last_ns is None or abs(t_ns - last_ns) >= TEMPERATURE_PERIOD_NS
        if is_due:
            self._temperature_ns = t_ns
        return is_due

    def _moved(self, after: WheelReading) -> Iterator[WheelMotion]:
        before, self._wheels = self._wheels, after
        if before is None:
            return
        self._pose = self._pose.moved(*wheel_step(before, after, self._config))
        sample = wheel_sample(before, after, self._config)
        if sample is not None:
            yield WheelMotion(sample, self._pose)
