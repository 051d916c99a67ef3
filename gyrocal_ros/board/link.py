"""The serial line to the board: the one module that knows pyserial."""

from __future__ import annotations

import errno
import os
import select
import termios
from contextlib import suppress
from types import TracebackType

import serial

from gyrocal_ros.errors import GyrocalError

READ_LIMIT_S = 0.1
"""A read waits for so long at most, so that commands and the end of the program need not wait."""
WRITE_LIMIT_S = 0.1
MOST_BYTES = 4096
"""More are left for the next read."""

FAILURES: dict[object, tuple[str, str]] = {
    errno.ENOENT: ('is not there', 'plug the board in, or name its port (`ls /dev/serial/by-id`)'),
    errno.EACCES: (
        'may not be opened',
        'join the group that owns it (`sudo usermod -aG dialout $USER`, log in anew) or add a udev rule',
    ),
    errno.EAGAIN: ('is in use', 'end the other program that has it open'),
    errno.ENOTTY: ('is no serial port', 'name the port of the board'),
}
FAILURES[errno.EISDIR] = FAILURES[errno.ENOTTY]
FAILURES[errno.EPERM] = FAILURES[errno.EACCES]
FAILURES[errno.EBUSY] = FAILURES[errno.EAGAIN]
GONE = ('is gone', 'see to the plug and the cable')
"""All else that the system says of a port means that the device behind it is not there any more."""


class LinkError(GyrocalError):
    """The port cannot be opened, or was lost; it may come back."""


class Link:
    """A serial port while it is open. Use it as a context: it is closed at the end.

    What the board sent before it was opened is thrown away, because nobody knows when that was.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        """Open a port for this program alone.

        Raises:
            LinkError: it cannot be opened.
        """
        self._port = port
        try:
            self._serial = serial.Serial(port, baud_rate, write_timeout=WRITE_LIMIT_S, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise _failure(port, error) from error
        # Some USB adapters hold bytes back for 16 ms. Where a port or system has no such mode, pyserial
        # raises one of these, and the port is as good without it.
        with suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def __enter__(self) -> Link:
        """Return the open port."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        with suppress(OSError):
            self._serial.close()

    def read(self) -> bytes:
        """Return all bytes that are there; wait for the first, and return none when it does not come.

        Raises:
            LinkError: the port was lost.
        """
        port = self._serial.fileno()
        try:
            ready, _, _ = select.select([port], [], [], READ_LIMIT_S)
            data = os.read(port, MOST_BYTES) if ready else None
        except OSError as error:
            raise _failure(self._port, error) from error
        if data == b'':  # ready, and yet nothing to read: the other end is closed
            raise _failure(self._port, OSError(errno.EIO, ''))
        return data or b''

    def write(self, data: bytes) -> None:
        """Send bytes; those that are not taken in a moment are thrown away.

        Raises:
            LinkError: the port was lost.
        """
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            pass  # a board that takes no commands may go on to measure
        except OSError as error:
            raise _failure(self._port, error) from error


def _failure(port: str, error: Exception) -> LinkError:
    """Say in words why a port is of no use."""
    cause = error if getattr(error, 'errno', None) else error.__context__ or error
    number = errno.ENOTTY if isinstance(error, ValueError) else cause.args[0]
    what, todo = FAILURES.get(number, GONE)
    return LinkError(what, where=port, todo=todo)
