"""Real-time play of an emulated board on a pseudo-terminal: the IO of the emulator."""

from __future__ import annotations

import os
import select
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gyrocal_ros.data import NS_PER_S, seconds
from gyrocal_ros.emulator.line import parse_fault
from gyrocal_ros.emulator.schedule import Emulator, PortEvent
from gyrocal_ros.errors import GyrocalError

POLL_S = 0.05
"""Interval at which an unopened port is checked for being opened."""
WRITE_TIMEOUT_S = 0.1
"""Timeout of a write to a busy host; after a longer stall, several frames are written at once."""
MISSED_NS = NS_PER_S // 10
"""Events that were due longer than this before the start of the play are skipped, as nobody was connected."""


class PseudoTerminal:
    """A pseudo-terminal that can be connected and disconnected like the port of a board.

    Args:
        link: symbolic link to it that exists while it is connected.
    """

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._master: int | None = None
        self.name = ''

    def plug_in(self) -> None:
        """Create the port.

        Raises:
            GyrocalError: the link cannot be made.
        """
        self._master, slave = os.openpty()
        self.name = os.ttyname(slave)
        tty.setraw(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        if self._link is not None:
            _set_link(self._link, self.name)

    def close(self) -> None:
        """Remove the port, disconnecting the program that has it open."""
        if self._master is not None:
            with suppress(OSError):
                if self._link is not None and os.readlink(self._link) == self.name:
                    self._link.unlink()
            os.close(self._master)
            self._master = None

    def open_end(self) -> int | None:
        """Return the master end while a program has the other end open, otherwise None."""
        if self._master is None:
            return None
        poll = select.poll()
        poll.register(self._master, 0)  # a hang-up is always reported
        return None if poll.poll(0) else self._master

    def write(self, data: bytes) -> None:
        """Write bytes; they are lost if nobody reads them, as on a serial line."""
        end = self.open_end()
        if end is not None:
            with suppress(OSError):
                while data and select.select([], [end], [], WRITE_TIMEOUT_S)[1]:
                    data = data[os.write(end, data) :]

    def read(self) -> bytes:
        """Return the bytes received, if any."""
        end = self.open_end()
        if end is not None:
            with suppress(OSError):
                return os.read(end, 4096)
        return b''


class RealTimePlayer:
    """Plays an emulator on a pseudo-terminal in real time.

    Args:
        emulator: source of the events.
        port: the pseudo-terminal.
        report: called with a message when the port changes.
        typed: file descriptor of faults to be injected immediately, one per line.
    """

    def __init__(
        self,
        emulator: Emulator,
        port: PseudoTerminal,
        report: Callable[[str], None],
        typed: int | None = None,
    ) -> None:
        self._emulator, self._port, self._report, self._typed = emulator, port, report, typed
        self._zero_ns = 0

    def play(self, start_at_s: float) -> None:
        """Play from the beginning to the end.

        Args:
            start_at_s: time 0 of the recording as time of day, in seconds since the epoch.

        Raises:
            GyrocalError: the link to the port cannot be made.
        """
        # Only the start follows the time of day, which may be set while playing.
        self._zero_ns = round(start_at_s * NS_PER_S) - time.time_ns() + time.monotonic_ns()
        is_started = False
        while (due_ns := self._emulator.next_ns()) is not None:
            late_ns = self._now_ns() - due_ns
            if late_ns < 0:
                is_started = True
                self._wait(-seconds(late_ns))
                continue
            event = self._emulator.pop()
            if isinstance(event, PortEvent):
                self._plug(event.is_connected)
            elif is_started or late_ns < MISSED_NS:
                self._port.write(event.data)

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self._zero_ns

    def _plug(self, is_connected: bool) -> None:
        if is_connected:
            self._port.plug_in()
            self._report(f'plugged in at {self._port.name}')
        else:
            self._port.close()
            self._report('unplugged')

    def _wait(self, limit_s: float) -> None:
        """Wait for a time, or for input from the host or the keyboard."""
        end = self._port.open_end()
        ends = [file for file in (end, self._typed) if file is not None]
        ready, _, _ = select.select(ends, [], [], limit_s if end is not None else min(limit_s, POLL_S))
        if end in ready:
            self._emulator.receive(self._port.read(), self._now_ns())
        if self._typed in ready:
            self._read_faults()

    def _read_faults(self) -> None:
        assert self._typed is not None
        try:
            text = os.read(self._typed, 4096).decode(errors='replace')
        except OSError:
            text = ''
        for line in text.splitlines():
            try:
                self._emulator.add_fault(parse_fault(line, self._now_ns()))
            except GyrocalError as error:
                self._report(str(error))
        if not text:
            self._typed = None  # end of file


def _set_link(link: Path, target: str) -> None:
    """Point a symbolic link to `target` in one atomic step."""
    if link.exists() and not link.is_symlink():
        raise GyrocalError('is not a symbolic link', where=str(link), todo='choose another name for --link')
    part = link.with_name(f'.{link.name}.{os.getpid()}.part')
    try:
        part.symlink_to(target)
        part.replace(link)
    except OSError as error:
        raise GyrocalError(
            f'cannot be made ({error.strerror})', where=str(link), todo='check the path and its permissions'
        ) from error
