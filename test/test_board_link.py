"""The serial link on a real pseudo-terminal: both directions, loss of the port, and failures to open it."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import pytest
import serial

from gyrocal_ros.board import link as module
from gyrocal_ros.board.link import Link, LinkError

BAUD = 115200


@dataclass
class Terminal:
    """A pseudo-terminal; the test is the board."""

    board: int
    port: str

    def send(self, data: bytes) -> None:
        os.write(self.board, data)

    def hang_up(self) -> None:
        os.close(self.board)
        self.board = -1

    def close(self) -> None:
        if self.board >= 0:
            os.close(self.board)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    board, host = os.openpty()
    port = os.ttyname(host)
    os.close(host)
    with closing(Terminal(board, port)) as terminal:
        yield terminal


def test_all_bytes_are_transferred_both_ways(terminal: Terminal) -> None:
    all_bytes = bytes(range(256))
    with Link(terminal.port, BAUD) as link:
        terminal.send(all_bytes)
        received = b''
        while len(received) < len(all_bytes):
            received += link.read()
        link.write(all_bytes)
        assert received == all_bytes
        assert os.read(terminal.board, 1000) == all_bytes


def test_available_bytes_are_read_at_once_and_none_is_no_error(terminal: Terminal) -> None:
    with Link(terminal.port, BAUD) as link:
        terminal.send(b'abc')
        assert link.read() == b'abc'
        assert link.read() == b''


def test_bytes_from_before_opening_are_discarded(terminal: Terminal) -> None:
    with Link(terminal.port, BAUD):
        pass
    terminal.send(b'old')
    with Link(terminal.port, BAUD) as link:
        terminal.send(b'new')
        assert link.read() == b'new'


def test_a_hang_up_raises_in_read_and_in_write(terminal: Terminal) -> None:
    with Link(terminal.port, BAUD) as link:
        terminal.hang_up()
        with pytest.raises(LinkError, match='is gone; check the plug'):
            link.read()
        with pytest.raises(LinkError, match='is gone'):
            link.write(b'abc')
    with pytest.raises(LinkError, match='is not there; plug the board in'), Link(terminal.port, BAUD):
        pass


def test_a_board_that_accepts_nothing_is_still_read(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'WRITE_TIMEOUT_S', 0.001)
    with Link(terminal.port, BAUD) as link:
        link.write(bytes(1_000_000))
        terminal.send(b'abc')
        assert link.read() == b'abc'


def test_a_port_is_exclusive_to_one_program(terminal: Terminal) -> None:
    with (
        Link(terminal.port, BAUD),
        pytest.raises(LinkError, match='is in use; end the other'),
        Link(terminal.port, BAUD),
    ):
        pass
    with Link(terminal.port, BAUD):
        pass


@pytest.mark.parametrize('port', ['/dev/null', '/', __file__])
def test_a_path_that_is_not_a_serial_port_is_refused(port: str) -> None:
    with pytest.raises(LinkError, match='is not a serial port'), Link(port, BAUD):
        pass


@pytest.mark.parametrize('number', [errno.EACCES, errno.EPERM])
def test_missing_permission_names_the_group(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise serial.SerialException(number, 'could not open port')

    monkeypatch.setattr(serial, 'Serial', refuse)
    with pytest.raises(LinkError, match='/dev/ttyUSB0: may not be opened; join the group .* dialout'):
        Link('/dev/ttyUSB0', BAUD)
