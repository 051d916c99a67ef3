"""The wire table: every message of the board, declared once; packing and unpacking derive from it.

A message is a frozen dataclass whose fields say how they travel. All is little-endian and nothing
is padded. A layout that is in use never changes: what needs other fields gets a new type number.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from enum import IntEnum
from itertools import islice
from typing import Any, ClassVar, TypeAlias


@dataclass(frozen=True, slots=True)
class Wire:
    """How one field travels."""

    kind: str
    """`u8`, `u16`, `i16` or `i32`."""
    unit: str
    help: str
    count: int = 1
    """Number of values; a field of more than one is a tuple."""


KINDS = {'u8': 'B', 'u16': 'H', 'i16': 'h', 'i32': 'i'}
"""Letters of the module `struct`."""


def wire(kind: str, unit: str, help: str, count: int = 1) -> Any:
    """Declare a dataclass field together with how it travels."""
    return field(metadata={'wire': Wire(kind, unit, help, count)})


# --- from the board -----------------------------------------------------------------------------

Three: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Imu:
    """One reading of the gyros and the accelerometers, as the converter gave it."""

    TYPE: ClassVar[int] = 0x01
    gyro: Three = wire('i32', 'count', 'rates about body x, y, z', 3)
    accelerometer: Three = wire('i16', 'count', 'specific force along body x, y, z', 3)
    temperature: int = wire('i16', 'count', 'temperature of the gyro die or its board')


@dataclass(frozen=True, slots=True)
class Wheels:
    """The tick counters of both wheels: sums since power-on, which wrap."""

    TYPE: ClassVar[int] = 0x02
    left: int = wire('i32', 'tick', 'left wheel, forward counts up')
    right: int = wire('i32', 'tick', 'right wheel, forward counts up')


@dataclass(frozen=True, slots=True)
class Supply:
    """The battery's side of the robot."""

    TYPE: ClassVar[int] = 0x03
    voltage: int = wire('u16', 'mV', 'supply voltage')
    motor_current: int = wire('i32', 'mA', 'current of the drive motors, negative when discharging')


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """The board's answer to a command, one for each that arrives whole."""

    TYPE: ClassVar[int] = 0x0F
    sequence: int = wire('u16', '', 'sequence number of the command')
    command: int = wire('u8', '', 'type of the command')
    result: int = wire('u8', '', 'what became of it: 0 done, 1 unknown, 2 out of range, 3 refused')


class CommandResult(IntEnum):
    """What became of a command; firmware newer than this may know more."""

    DONE = 0
    UNKNOWN = 1
    OUT_OF_RANGE = 2
    REFUSED = 3


# --- to the board -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SetRates:
    """How often the board is to send each message; 0 stops it."""

    TYPE: ClassVar[int] = 0x81
    imu: int = wire('u16', 'Hz', 'rate of `Imu`')
    wheels: int = wire('u16', 'Hz', 'rate of `Wheels`')
    supply: int = wire('u16', 'Hz', 'rate of `Supply`')


@dataclass(frozen=True, slots=True)
class Zero:
    """Take the mean of the gyro counts while the robot stands still for the zero of all three."""

    TYPE: ClassVar[int] = 0x82
    duration: int = wire('u16', 'ms', 'how long to average')


Message: TypeAlias = Imu | Wheels | Supply | Acknowledgement | SetRates | Zero
MESSAGES: tuple[type[Message], ...] = (Imu, Wheels, Supply, Acknowledgement, SetRates, Zero)


# --- what derives from the table ----------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The bytes of one type of message."""

    message: type[Message]
    columns: tuple[tuple[str, Wire], ...]
    """Name and wire form of each field, in order."""
    code: struct.Struct

    def numbers(self, message: Message) -> list[int]:
        """The values of a message in the order in which they travel."""
        values = ((getattr(message, name), about.count) for name, about in self.columns)
        return [n for value, count in values for n in (value if count > 1 else (value,))]

    def build(self, numbers: Iterable[int]) -> Message:
        """Undo `numbers`."""
        left = iter(numbers)
        values = (
            tuple(islice(left, about.count)) if about.count > 1 else next(left) for _, about in self.columns
        )
        make: Callable[..., Message] = self.message
        return make(*values)


def _layout(message: type[Message]) -> Layout:
    columns = tuple((item.name, item.metadata['wire']) for item in fields(message))
    letters = ''.join(f'{about.count}{KINDS[about.kind]}' for _, about in columns)
    return Layout(message, columns, struct.Struct(f'<{letters}'))


LAYOUTS = {message.TYPE: _layout(message) for message in MESSAGES}
LARGEST = max(layout.code.size for layout in LAYOUTS.values())
"""Bytes of the largest message."""


def pack(message: Message) -> bytes:
    """Return the bytes of a message, without header and checksum.

    Raises:
        ValueError: a value does not fit into its field.
    """
    layout = LAYOUTS[message.TYPE]
    try:
        return layout.code.pack(*layout.numbers(message))
    except struct.error as error:
        raise ValueError(f'{message} does not fit on the wire: {error}') from error


def unpack(kind: int, payload: bytes) -> Message | None:
    """Return the message of a type number and its bytes; None where the table does not have it."""
    layout = LAYOUTS.get(kind)
    if layout is None or layout.code.size != len(payload):
        return None
    return layout.build(layout.code.unpack(payload))
