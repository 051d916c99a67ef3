"""The wire table: each message of the board, declared once; packing and unpacking derive from it.

A message is a frozen dataclass whose fields declare their wire format. All values are little-endian,
without padding. A layout that is in use never changes: a message with other fields gets a new type
number.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from enum import IntEnum
from itertools import islice
from typing import Any, ClassVar, TypeAlias


@dataclass(frozen=True, slots=True)
class WireFormat:
    """Wire format of one field."""

    kind: str
    """Type of a value: `u8`, `u16`, `i16` or `i32`."""
    unit: str
    help: str
    count: int = 1
    """Number of values; a field of more than one is a tuple."""


STRUCT_CODES = {'u8': 'B', 'u16': 'H', 'i16': 'h', 'i32': 'i'}
"""Format characters of the module `struct`."""


def wire_field(kind: str, unit: str, help: str, count: int = 1) -> Any:
    """Declare a dataclass field together with its wire format."""
    return field(metadata={'wire': WireFormat(kind, unit, help, count)})


# --- from the board -----------------------------------------------------------------------------

IntTriple: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Imu:
    """One reading of the gyros and the accelerometers, in converter counts."""

    TYPE: ClassVar[int] = 0x01
    gyro: IntTriple = wire_field('i32', 'count', 'rates about body x, y, z', 3)
    accelerometer: IntTriple = wire_field('i16', 'count', 'specific force along body x, y, z', 3)
    temperature: int = wire_field('i16', 'count', 'temperature of the gyro die or its board')


@dataclass(frozen=True, slots=True)
class Wheels:
    """Tick counters of both wheels: sums since power-on, which wrap."""

    TYPE: ClassVar[int] = 0x02
    left: int = wire_field('i32', 'tick', 'left wheel, forward counts up')
    right: int = wire_field('i32', 'tick', 'right wheel, forward counts up')


@dataclass(frozen=True, slots=True)
class Supply:
    """Battery voltage and motor current."""

    TYPE: ClassVar[int] = 0x03
    voltage: int = wire_field('u16', 'mV', 'supply voltage')
    motor_current: int = wire_field('i32', 'mA', 'current of the drive motors, negative when discharging')


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """Answer of the board to a command, one for each command that is received intact."""

    TYPE: ClassVar[int] = 0x0F
    sequence: int = wire_field('u16', '', 'sequence number of the command')
    command: int = wire_field('u8', '', 'type of the command')
    result: int = wire_field('u8', '', 'result: 0 done, 1 unknown, 2 out of range, 3 refused')


class CommandResult(IntEnum):
    """Result of a command; newer firmware may report other values."""

    DONE = 0
    UNKNOWN = 1
    OUT_OF_RANGE = 2
    REFUSED = 3


# --- to the board -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SetRates:
    """Sets the rate at which the board sends each message; 0 stops a message."""

    TYPE: ClassVar[int] = 0x81
    imu: int = wire_field('u16', 'Hz', 'rate of `Imu`')
    wheels: int = wire_field('u16', 'Hz', 'rate of `Wheels`')
    supply: int = wire_field('u16', 'Hz', 'rate of `Supply`')


@dataclass(frozen=True, slots=True)
class Zero:
    """Measures the mean gyro counts while the robot stands still; they become the zeros of the gyros."""

    TYPE: ClassVar[int] = 0x82
    duration: int = wire_field('u16', 'ms', 'averaging time')


Message: TypeAlias = Imu | Wheels | Supply | Acknowledgement | SetRates | Zero
MESSAGES: tuple[type[Message], ...] = (Imu, Wheels, Supply, Acknowledgement, SetRates, Zero)


# --- derived from the table ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Binary layout of one message type."""

    message: type[Message]
    columns: tuple[tuple[str, WireFormat], ...]
    """Name and wire format of each field, in order."""
    code: struct.Struct

    def numbers(self, message: Message) -> list[int]:
        """Return the values of a message in wire order."""
        values = ((getattr(message, name), wire_format.count) for name, wire_format in self.columns)
        return [n for value, count in values for n in (value if count > 1 else (value,))]

    def build(self, numbers: Iterable[int]) -> Message:
        """Return the message with these values, the inverse of `numbers`."""
        left = iter(numbers)
        values = (
            tuple(islice(left, wire_format.count)) if wire_format.count > 1 else next(left)
            for _, wire_format in self.columns
        )
        make: Callable[..., Message] = self.message
        return make(*values)


def _layout(message: type[Message]) -> Layout:
    columns = tuple((item.name, item.metadata['wire']) for item in fields(message))
    letters = ''.join(f'{wire_format.count}{STRUCT_CODES[wire_format.kind]}' for _, wire_format in columns)
    return Layout(message, columns, struct.Struct(f'<{letters}'))


LAYOUTS = {message.TYPE: _layout(message) for message in MESSAGES}
MAX_MESSAGE_SIZE = max(layout.code.size for layout in LAYOUTS.values())
"""Size of the largest message, bytes."""


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
    """Return the message of a type number and its bytes, or None if the table does not contain it."""
    layout = LAYOUTS.get(kind)
    if layout is None or layout.code.size != len(payload):
        return None
    return layout.build(layout.code.unpack(payload))
