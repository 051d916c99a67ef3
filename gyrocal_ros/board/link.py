"""The serial port of the board: the only module that uses pyserial."""

from __future__ import annotations

import errno
import os
import select
import termios
from contextlib import suppress
from types import TracebackType

import serial

from gyrocal_ros.errors import GyrocalError

READ_TIMEOUT_S = 0.1
"""Timeout of a read. It is short so that commands and the end of the program are not delayed."""
WRITE_TIMEOUT_S = 0.1
MAX_READ_BYTES = 4096
"""Largest number of bytes of one read; the rest is left for the next read."""

FAILURES: dict[object, tuple[str, str]] = {
    errno.ENOENT: ('is not there', 'plug the board in, or name its port (`ls /dev/serial/by-id`)'),
    errno.EACCES: (
        'may not be opened',
        'join the group that owns it (`sudo usermod -aG dialout $USER`, log in again) or add a udev rule',
    ),
    errno.EAGAIN: ('is in use', 'end the other program that has it open'),
    errno.ENOTTY: ('is not a serial port', 'name the port of the board'),
}
FAILURES[errno.EISDIR] = FAILURES[errno.ENOTTY]
FAILURES[errno.EPERM] = FAILURES[errno.EACCES]
FAILURES[errno.EBUSY] = FAILURES[errno.EAGAIN]
DISCONNECTED = ('is gone', 'check the plug and the cable')
"""Description of all other system errors: the device is no longer connected."""


class LinkError(GyrocalError):
    """The port cannot be opened, or was lost; it may come back."""


class Link:
    """An open serial port, used as a context manager that closes it.

    Bytes received before it was opened are discarded because their arrival time is unknown.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        """Open a port with exclusive access.

        Raises:
            LinkError: it cannot be opened.
        """
        self._port = port
        try:
            self._serial = serial.Serial(port, baud_rate, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            raise _failure(port, error) from error
        # Some USB adapters hold bytes back for 16 ms. Where the port or the system does not have this
        # mode, pyserial raises one of these errors, and the port works without it.
        with suppress(OSError, ValueError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def __enter__(self) -> Link:
        """Return the open port."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the port."""
        with suppress(OSError):
            self._serial.close()

    def read(self) -> bytes:
        """Return all bytes received; wait for the first, and return none after the timeout.

        Raises:
            LinkError: the port was lost.
        """
        port = self._serial.fileno()
        try:
            ready, _, _ = select.select([port], [], [], READ_TIMEOUT_S)
            data = os.read(port, MAX_READ_BYTES) if ready else None
        except OSError as error:
            raise _failure(self._port, error) from error
        if data == b'':  # ready but no data: the other end is closed
            raise _failure(self._port, OSError(errno.EIO, ''))
        return data or b''

    def write(self, data: bytes) -> None:
        """Send bytes; those that are not accepted within the timeout are discarded.

        Raises:
            LinkError: the port was lost.
        """
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            pass  # a board that does not accept commands may still send measurements
        except OSError as error:
            raise _failure(self._port, error) from error


def _failure(port: str, error: Exception) -> LinkError:
    """Return an error that describes why a port cannot be used."""
    cause = error if getattr(error, 'errno', None) else error.__context__ or error
    number = errno.ENOTTY if isinstance(error, ValueError) else cause.args[0]
    what, todo = FAILURES.get(number, DISCONNECTED)
    return LinkError(what, where=port, todo=todo)
