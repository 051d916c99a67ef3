"""What an emulated board sends, and when: a recording is played, without any IO.

All that is random comes from one seed, and nothing looks at a clock: asked for the same things at
the same times, it does the same.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

from gyrocal_ros.data import ClockStep, Measurement
from gyrocal_ros.emulator.board import EmulatedBoard
from gyrocal_ros.emulator.line import Delivery, EmulatedLine, Fault, FaultKind


@dataclass(frozen=True, slots=True)
class Plug:
    """The port is pulled out or put in."""

    t_ns: int
    is_in: bool


class Emulator:
    """Plays a recording as a board at the end of a line. Times count from the start of the recording.

    Args:
        measurements: in the order of their stamps.
        start_ns: the stamp that is time 0.
        board: makes frames of them.
        line: carries these.
    """

    def __init__(
        self, measurements: Iterator[Measurement], start_ns: int, board: EmulatedBoard, line: EmulatedLine
    ) -> None:
        self._measurements, self._start_ns = measurements, start_ns
        self._board, self._line = board, line
        self._has_power = True
        self._order = count()
        self._events: list[tuple[int, int, Delivery | Plug]] = []
        for fault in line.faults:
            self._foresee(fault)
        self._next = self._measured()

    def next_ns(self) -> int | None:
        """When the next thing happens; None when all is played."""
        while self._next and not (self._events and self._events[0][0] <= self._next[0]):
            t_ns, measurement = self._next
            self._play(measurement, t_ns)
            self._next = self._measured()
        return self._events[0][0] if self._events else None

    def pop(self) -> Delivery | Plug:
        """Return what happens then; call it after `next_ns`."""
        return heapq.heappop(self._events)[2]

    def hear(self, data: bytes, now_ns: int) -> None:
        """Let the board have bytes from the host."""
        if not self._is_off(now_ns):
            for frame in self._board.hear(data, now_ns):
                self._carry(frame, now_ns)

    def spoil(self, fault: Fault) -> None:
        """Let something more go wrong."""
        self._line.faults.append(fault)
        self._foresee(fault)

    def _measured(self) -> tuple[int, Measurement] | None:
        for measurement in self._measurements:
            if isinstance(measurement, ClockStep):
                self._start_ns += measurement.step_ns  # time itself went on
            else:
                return measurement.t_ns - self._start_ns, measurement
        return None

    def _play(self, measurement: Measurement, t_ns: int) -> None:
        had_power, self._has_power = self._has_power, not self._is_off(t_ns)
        if not self._has_power:
            return
        if not had_power:
            self._board.restart(t_ns)
        for frame in self._board.measure(measurement, t_ns):
            self._carry(frame, t_ns)

    def _is_off(self, t_ns: int) -> bool:
        return any(fault.kind is FaultKind.RESTART and fault.holds(t_ns) for fault in self._line.faults)

    def _carry(self, frame: bytes, t_ns: int) -> None:
        delivery = self._line.carry(frame, t_ns)
        if delivery is not None:
            self._foresee_event(delivery)

    def _foresee(self, fault: Fault) -> None:
        if fault.kind is FaultKind.UNPLUG:
            self._foresee_event(Plug(fault.from_ns, is_in=False))
            self._foresee_event(Plug(fault.until_ns, is_in=True))

    def _foresee_event(self, event: Delivery | Plug) -> None:
        heapq.heappush(self._events, (event.t_ns, next(self._order), event))
