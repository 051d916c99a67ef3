"""How the board and the line to it are, in sentences."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import Field, dataclass, fields, replace
from typing import Any

from gyrocal_ros.board.clock import RestartCause
from gyrocal_ros.board.commands import PendingCommand
from gyrocal_ros.board.messages import CommandResult, Imu, SetRates, Supply, Wheels
from gyrocal_ros.board.protocol import Counts
from gyrocal_ros.board.reader import BoardReader
from gyrocal_ros.robot.health import Complaint, Level, Status, status

RECENT_S = 5.0
"""What happened is told for so long."""
QUIET_S = 1.0
"""A board that sends nothing for so long does not send."""
FEW = 3
"""Spoiled frames that may come before the first whole one."""
ENOUGH = 0.9
"""Part of a rate asked for that has to come."""
MANY = 0.5
"""A share of spoiled frames with which nothing can be done."""
MANY_TRIES = 4
"""A command that was sent so often will not be answered."""


@dataclass(frozen=True, slots=True)
class PortState:
    """Whether the port is open."""

    is_open: bool
    since_s: float
    """When that began, by a clock that is never set."""
    why: str = ''
    """What is in the way, and what to do about it."""


@dataclass(frozen=True, slots=True)
class Tally:
    """All that was counted up to a moment, or between two."""

    time_s: float
    bytes: int
    imu: int
    wheels: int
    supply: int
    board_restarts: int
    clock_sets: int
    odd_times: int
    connections: int
    frames: Counts

    def since(self, before: Tally) -> Tally:
        """What was counted since another moment, and how long that was."""
        frames = Counts(**_differences(self.frames, before.frames, fields(Counts)))
        return Tally(**_differences(self, before, fields(Tally)[:-1]), frames=frames)

    @property
    def spoiled(self) -> int:
        """Frames that came in another form than they were sent."""
        return self.frames.malformed + self.frames.bad_checksums


def tally(reader: BoardReader, connections: int, now_s: float) -> Tally:
    """Take down what a reader has counted."""
    received, restarts = reader.received, reader.clock.restarts
    return Tally(
        time_s=now_s,
        bytes=reader.bytes,
        imu=received[Imu],
        wheels=received[Wheels],
        supply=received[Supply],
        board_restarts=restarts[RestartCause.BOARD],
        clock_sets=restarts[RestartCause.ARRIVALS],
        odd_times=reader.clock.outliers,
        connections=connections,
        frames=replace(reader.decoder.counts),
    )


class BoardHealth:
    """Tells what is wrong now, or was a moment ago; asked once a second or so.

    Args:
        start: the counts at the start.
    """

    def __init__(self, start: Tally) -> None:
        self._tallies = deque([start])
        self._asked: SetRates | None = None
        self._asked_s = start.time_s

    def tell(self, now: Tally, line: PortState, heard_s: float, rates: PendingCommand[SetRates]) -> Status:
        """Judge by the counts, the port, when something came last, and the rates asked for."""
        while len(self._tallies) > 1 and self._tallies[1].time_s <= now.time_s - RECENT_S:
            self._tallies.popleft()
        recent = now.since(self._tallies[0])
        self._tallies.append(now)
        if rates.command != self._asked:
            self._asked, self._asked_s = rates.command, now.time_s
        steady_s = now.time_s - max(line.since_s, self._asked_s)
        complaints = [*_of_line(now.time_s, line, heard_s, recent)] or [
            *_of_frames(recent),
            *_of_time(recent),
            *_of_rates(recent, rates, is_steady=steady_s > recent.time_s and not recent.board_restarts),
        ]
        comes = ', '.join(f'{name} {hz:.0f} Hz' for name, hz, _ in _rates(recent, rates.command))
        return status(comes, complaints, _numbers(now, recent, rates.command))


def _of_line(now_s: float, line: PortState, heard_s: float, recent: Tally) -> Iterator[Complaint]:
    """What keeps everything from coming."""
    quiet_s = now_s - max(line.since_s, heard_s)
    if not line.is_open:
        yield Complaint(Level.ERROR, f'not connected for {now_s - line.since_s:.0f} s: {line.why}')
    elif quiet_s > QUIET_S:
        yield Complaint(
            Level.ERROR,
            f'nothing has come from the board for {quiet_s:.0f} s: see to its supply and its program',
        )
    elif recent.spoiled > FEW and not recent.frames.packets:
        yield Complaint(
            Level.ERROR,
            'what comes is not from the board: see to driver.port and to driver.baud_rate',
        )


def _of_frames(recent: Tally) -> Iterator[Complaint]:
    """What became of the frames of late."""
    frames = recent.frames
    if recent.spoiled:
        share = recent.spoiled / (recent.spoiled + frames.packets)
        yield Complaint(
            Level.ERROR if share > MANY else Level.WARN,
            f'{share:.0%} of the frames came spoiled ({recent.spoiled} of late): see to cable and ground',
        )
    lost = frames.lost - recent.spoiled  # a spoiled frame is missing, too
    if lost > 0:
        yield Complaint(Level.WARN, f'{lost} frames were lost of late')
    if frames.unknown:
        yield Complaint(
            Level.WARN, f'{frames.unknown} messages of unknown types came of late: the board is newer'
        )


def _of_time(recent: Tally) -> Iterator[Complaint]:
    """What happened to the clocks of late."""
    if recent.board_restarts:
        yield Complaint(Level.WARN, 'the board was started anew: see to its supply')
    elif recent.odd_times:
        yield Complaint(Level.WARN, f'{recent.odd_times} messages came with odd board times and are left out')
    if recent.clock_sets:
        yield Complaint(Level.WARN, "this computer's clock was set: the stamps follow it")


def _of_rates(recent: Tally, order: PendingCommand[SetRates], *, is_steady: bool) -> Iterator[Complaint]:
    """Whether as much comes as was asked for."""
    asked = order.command
    if order.result is None and order.attempts >= MANY_TRIES:
        yield Complaint(Level.WARN, 'the board does not answer commands')
    elif order.result not in (None, CommandResult.DONE):
        yield Complaint(
            Level.WARN,
            f'the board cannot send {asked.imu} IMU, {asked.wheels} wheel and {asked.supply} supply '
            'messages a second: set driver.imu_hz, driver.wheels_hz and driver.supply_hz',
        )
    elif is_steady and not recent.spoiled and not recent.frames.lost:
        for name, hz, asked_hz in _rates(recent, asked):
            if hz < ENOUGH * asked_hz:
                yield Complaint(Level.WARN, f'{name} {hz:.0f} Hz, not the {asked_hz} asked for')


def _rates(recent: Tally, asked: SetRates) -> list[tuple[str, float, int]]:
    """Name of each message, its rate of late, and the rate asked for."""
    time_s = max(recent.time_s, 1e-3)
    counts = (('IMU', recent.imu, asked.imu), ('wheels', recent.wheels, asked.wheels))
    return [(name, n / time_s, hz) for name, n, hz in (*counts, ('supply', recent.supply, asked.supply))]


def _numbers(now: Tally, recent: Tally, asked: SetRates) -> dict[str, object]:
    """All counts since the start."""
    rates = {f'{name.lower()}_hz': round(hz, 1) for name, hz, _ in _rates(recent, asked)}
    counts = {item.name: getattr(now, item.name) for item in fields(Tally)[1:-1]}
    return {**rates, **counts, **{item.name: getattr(now.frames, item.name) for item in fields(Counts)}}


def _differences(after: object, before: object, names: Iterable[Field[Any]]) -> dict[str, Any]:
    return {item.name: getattr(after, item.name) - getattr(before, item.name) for item in names}
