"""Events of an emulated board in time order, without IO.

All randomness derives from one seed, and no clock is read: the same calls yield the same events.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

from gyrocal_ros.data import ClockStep, ImuSample, Measurement
from gyrocal_ros.emulator.board import EmulatedBoard
from gyrocal_ros.emulator.line import DataEvent, EmulatedLine, Fault, FaultKind


@dataclass(frozen=True, slots=True)
class PortEvent:
    """The port is connected or disconnected."""

    t_ns: int
    is_connected: bool


class Emulator:
    """Plays a recording as a board at the end of a line. Times are relative to the start of the recording.

    Args:
        measurements: measurements in the order of their stamps.
        start_ns: stamp of time 0.
        board: converts measurements to frames.
        line: delivers the frames.
    """

    def __init__(
        self, measurements: Iterator[Measurement], start_ns: int, board: EmulatedBoard, line: EmulatedLine
    ) -> None:
        self._measurements, self._start_ns = measurements, start_ns
        self._board, self._line = board, line
        self._has_power = True
        self._order = count()
        self._events: list[tuple[int, int, DataEvent | PortEvent]] = []
        for fault in line.faults:
            self._schedule_port(fault)
        self._next = self._measured()

    def next_ns(self) -> int | None:
        """Return the time of the next event, or None at the end of the recording."""
        while self._next and not (self._events and self._events[0][0] <= self._next[0]):
            t_ns, measurement = self._next
            self._play(measurement, t_ns)
            self._next = self._measured()
        return self._events[0][0] if self._events else None

    def pop(self) -> DataEvent | PortEvent:
        """Return the next event; call `next_ns` first."""
        return heapq.heappop(self._events)[2]

    def receive(self, data: bytes, now_ns: int) -> None:
        """Pass bytes from the host to the board."""
        if not self._is_off(now_ns):
            for frame in self._board.receive(data, now_ns):
                self._send(frame, now_ns)

    def add_fault(self, fault: Fault) -> None:
        """Add a fault while the emulator runs."""
        self._line.faults.append(fault)
        self._schedule_port(fault)

    def _measured(self) -> tuple[int, Measurement] | None:
        for measurement in self._measurements:
            if isinstance(measurement, ClockStep):
                self._start_ns += measurement.step_ns  # only the recorded clock stepped
            else:
                return measurement.t_ns - self._start_ns, measurement
        return None

    def _play(self, measurement: Measurement, t_ns: int) -> None:
        had_power, self._has_power = self._has_power, not self._is_off(t_ns)
        if not self._has_power:
            return
        if not had_power:
            self._board.restart(t_ns)
        if isinstance(measurement, ImuSample):
            measurement = self._with_gain(measurement, t_ns)
        for frame in self._board.measure(measurement, t_ns):
            self._send(frame, t_ns)

    def _with_gain(self, sample: ImuSample, t_ns: int) -> ImuSample:
        for fault in self._line.faults:
            if fault.kind is FaultKind.GAIN and fault.is_active(t_ns):
                x, y, z = sample.rate_rad_s
                gain = 1.0 - fault.share
                sample = replace(sample, rate_rad_s=(gain * x, gain * y, gain * z))
        return sample

    def _is_off(self, t_ns: int) -> bool:
        return any(fault.kind is FaultKind.RESTART and fault.is_active(t_ns) for fault in self._line.faults)

    def _send(self, frame: bytes, t_ns: int) -> None:
        event = self._line.carry(frame, t_ns)
        if event is not None:
            self._push(event)

    def _schedule_port(self, fault: Fault) -> None:
        if fault.kind is FaultKind.UNPLUG:
            self._push(PortEvent(fault.from_ns, is_connected=False))
            self._push(PortEvent(fault.until_ns, is_connected=True))

    def _push(self, event: DataEvent | PortEvent) -> None:
        heapq.heappush(self._events, (event.t_ns, next(self._order), event))
