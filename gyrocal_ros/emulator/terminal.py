"""Plays an emulated board on a pseudo-terminal, in real time: the IO of the emulator."""

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
from gyrocal_ros.emulator.schedule import Emulator, Plug
from gyrocal_ros.errors import GyrocalError

LOOK_AGAIN_S = 0.05
"""How often to look whether somebody has opened the port."""
PATIENCE_S = 0.1
"""How long a frame waits for a host that is busy; what held up many lets all of them go at once."""
MISSED_NS = NS_PER_S // 10
"""What was due so long before the play begins is left out: nobody was there to see it."""


class Port:
    """A pseudo-terminal that is plugged in and pulled out like the port of a board.

    Args:
        link: a symbolic link that leads to it while it is plugged in.
    """

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._master: int | None = None
        self.name = ''

    def plug_in(self) -> None:
        """Make the port.

        Raises:
            GyrocalError: the link cannot be made.
        """
        self._master, slave = os.openpty()
        self.name = os.ttyname(slave)
        tty.setraw(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        if self._link is not None:
            _lead(self._link, self.name)

    def close(self) -> None:
        """Take it away from whoever has it open."""
        if self._master is not None:
            with suppress(OSError):
                if self._link is not None and os.readlink(self._link) == self.name:
                    self._link.unlink()
            os.close(self._master)
            self._master = None

    def open_end(self) -> int | None:
        """Return our end while somebody has the other one open."""
        if self._master is None:
            return None
        poll = select.poll()
        poll.register(self._master, 0)  # a hang-up is told unasked
        return None if poll.poll(0) else self._master

    def write(self, data: bytes) -> None:
        """Send bytes; as on a wire, they are lost where nobody takes them."""
        end = self.open_end()
        if end is not None:
            with suppress(OSError):
                while data and select.select([], [end], [], PATIENCE_S)[1]:
                    data = data[os.write(end, data) :]

    def read(self) -> bytes:
        """Return what has come, if anything."""
        end = self.open_end()
        if end is not None:
            with suppress(OSError):
                return os.read(end, 4096)
        return b''


class TerminalPlayer:
    """Plays on a port, in real time.

    Args:
        emulator: what happens, and when.
        port: where.
        tell: told in words what happens to the port.
        typed: file of faults that are to come at once, one a line.
    """

    def __init__(
        self, emulator: Emulator, port: Port, tell: Callable[[str], None], typed: int | None = None
    ) -> None:
        self._emulator, self._port, self._tell, self._typed = emulator, port, tell, typed
        self._zero_ns = 0

    def play(self, start_at_s: float) -> None:
        """Play from the beginning to the end.

        Args:
            start_at_s: time of day, in seconds since the epoch, that is time 0 of the recording.

        Raises:
            GyrocalError: the link to the port cannot be made.
        """
        # Time of day tells when to begin; from then on it may be set.
        self._zero_ns = round(start_at_s * NS_PER_S) - time.time_ns() + time.monotonic_ns()
        begun = False
        while (due_ns := self._emulator.next_ns()) is not None:
            late_ns = self._now_ns() - due_ns
            if late_ns < 0:
                begun = True
                self._wait(-seconds(late_ns))
                continue
            event = self._emulator.pop()
            if isinstance(event, Plug):
                self._plug(event.is_in)
            elif begun or late_ns < MISSED_NS:
                self._port.write(event.data)

    def _now_ns(self) -> int:
        return time.monotonic_ns() - self._zero_ns

    def _plug(self, is_in: bool) -> None:
        if is_in:
            self._port.plug_in()
            self._tell(f'plugged in at {self._port.name}')
        else:
            self._port.close()
            self._tell('unplugged')

    def _wait(self, limit_s: float) -> None:
        """Wait for a while, or for what comes from the host and from the keyboard."""
        end = self._port.open_end()
        ends = [file for file in (end, self._typed) if file is not None]
        ready, _, _ = select.select(ends, [], [], limit_s if end is not None else min(limit_s, LOOK_AGAIN_S))
        if end in ready:
            self._emulator.hear(self._port.read(), self._now_ns())
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
                self._emulator.spoil(parse_fault(line, self._now_ns()))
            except GyrocalError as error:
                self._tell(str(error))
        if not text:
            self._typed = None  # its end


def _lead(link: Path, target: str) -> None:
    """Let a symbolic link lead to `target` from one moment to the next."""
    if link.exists() and not link.is_symlink():
        raise GyrocalError('is no symbolic link', where=str(link), todo='choose another name for --link')
    part = link.with_name(f'.{link.name}.{os.getpid()}.part')
    try:
        part.symlink_to(target)
        part.replace(link)
    except OSError as error:
        raise GyrocalError(
            f'cannot be made ({error.strerror})', where=str(link), todo='check the path and its permissions'
        ) from error
