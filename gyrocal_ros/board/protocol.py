"""Bytes become packets and packets bytes: COBS frames with a checksum, and no IO.

    frame = COBS(type u8 | sequence u16 | time u32 | message | checksum u16) 00

COBS (consistent overhead byte stuffing) takes every zero out of a frame, so that a zero byte always
is the end of one: whatever was lost or spoiled, the next frame begins after the next zero. The
checksum is CRC-16/CCITT in the variant CRC-16/IBM-3740, also known as CCITT-FALSE: polynomial
1021, start FFFF, nothing reflected, nothing inverted; it is 29B1 of the nine letters `123456789`.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass

from gyrocal_ros.board.messages import LARGEST, LAYOUTS, Message, pack, unpack

HEADER = struct.Struct('<BHI')
"""Type, sequence number, board time."""
CHECKSUM = struct.Struct('<H')
LARGEST_FRAME = HEADER.size + LARGEST + CHECKSUM.size + 1
"""Bytes of the longest frame, the zero at its end not counted; COBS adds one byte to so few."""
BITS_PER_BYTE = 10
"""A start bit, eight of data, a stop bit."""
SEQUENCE_WRAP = 1 << 16
TIME_WRAP = 1 << 32
MOST_LOST = 4096
"""A larger step of the sequence number is no loss but a restart of the count."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One message as it came over the line."""

    sequence: int
    """Counts all frames of a sender; 16 bits, wraps."""
    time_us: int
    """Board time of the measurement; 32 bits, wraps after 71.6 minutes. Nothing in a command."""
    message: Message


@dataclass(slots=True)
class Counts:
    """What became of all that came in since the start.

    Every stretch between two zeros that holds anything is counted once, under `packets`, `repeated`,
    `unknown`, `malformed` or `bad_checksums`.
    """

    packets: int = 0
    """Handed on."""
    repeated: int = 0
    """Whole, with the sequence number of the one before; left out."""
    unknown: int = 0
    """Whole, but of a type or a length that the table does not have; left out."""
    malformed: int = 0
    """No frame: cut, too short, too long, or noise."""
    bad_checksums: int = 0
    """Of the form of a frame, with something in it wrong."""
    resyncs: int = 0
    """Times that a whole frame came after something that was none."""
    lost: int = 0
    """Frames that never came whole, by the steps of the sequence number."""
    sequence_restarts: int = 0
    """Steps too large to be a loss: the board was started anew, or was away for long."""


def checksum(data: bytes) -> int:
    """CRC-16/IBM-3740 of some bytes."""
    return crc_hqx(data, 0xFFFF)


def stuff(data: bytes) -> bytes:
    """Take the zeros out of fewer than 254 bytes by COBS; the zero that ends a frame is not part of it."""
    return b''.join(bytes((len(piece) + 1,)) + piece for piece in data.split(b'\0'))


def unstuff(frame: bytes) -> bytes | None:
    """Undo `stuff`; None where a stretch between two zeros cannot have come out of it."""
    pieces = []
    while frame:
        code = frame[0]
        if code > len(frame):
            return None
        pieces.append(frame[1:code])
        frame = frame[code:]
    return b'\0'.join(pieces)


def encode(message: Message, sequence: int, time_us: int = 0) -> bytes:
    """Return the frame of a message, the zero at its end included.

    Args:
        message: what to send.
        sequence: how many frames were sent before; it is cut to 16 bits.
        time_us: time of measurement in microseconds; it is cut to 32 bits.

    Raises:
        ValueError: a value of the message does not fit into its field.
    """
    body = HEADER.pack(message.TYPE, sequence % SEQUENCE_WRAP, time_us % TIME_WRAP) + pack(message)
    return stuff(body + CHECKSUM.pack(checksum(body))) + b'\0'


def wire_s(kind: type[Message], baud_rate: int) -> float:
    """How long a frame is on the wire: from its first bit to its last, the zero included."""
    size = HEADER.size + LAYOUTS[kind.TYPE].code.size + CHECKSUM.size + 2
    return size * BITS_PER_BYTE / baud_rate


class Decoder:
    """Takes bytes in any portions and hands on the packets that are whole.

    What comes out and all counts depend on the bytes alone, not on how they were cut. Nothing that
    comes in raises an error.

    Args:
        on_unknown: told of type and sequence number of a whole frame that the table does not have.
    """

    def __init__(self, on_unknown: Callable[[int, int], None] = lambda kind, sequence: None) -> None:
        self._on_unknown = on_unknown
        self.counts = Counts()
        self._rest = b''
        self._in_sync = True
        self._joins = False
        self._sequence: int | None = None

    def join(self) -> None:
        """Begin to listen to a line that is being used: the rest of a frame may come first, uncounted."""
        self._rest, self._joins = b'', True

    def feed(self, data: bytes) -> list[Packet]:
        """Take the next bytes and return the packets that they complete, in order."""
        *frames, rest = (self._rest + data).split(b'\0')
        if frames and self._joins:
            self._joins = False
            del frames[0]
        self._rest = rest[: LARGEST_FRAME + 1]  # the rest of an endless frame only makes it too long
        packets = (self._packet(frame) for frame in frames if frame)
        return [packet for packet in packets if packet is not None]

    def _packet(self, frame: bytes) -> Packet | None:
        body = self._body(frame)
        if body is None:
            self._in_sync = False
            return None
        if not self._in_sync:
            self._in_sync = True
            self.counts.resyncs += 1
        kind, sequence, time_us = HEADER.unpack_from(body)
        if self._is_repeated(sequence):
            self.counts.repeated += 1
            return None
        message = unpack(kind, body[HEADER.size :])
        if message is None:
            self.counts.unknown += 1
            self._on_unknown(kind, sequence)
            return None
        self.counts.packets += 1
        return Packet(sequence, time_us, message)

    def _body(self, frame: bytes) -> bytes | None:
        """Return header and message of a frame; None where it is not whole."""
        data = unstuff(frame) if len(frame) <= LARGEST_FRAME else None
        if data is None or len(data) < HEADER.size + CHECKSUM.size:
            self.counts.malformed += 1
            return None
        body = data[: -CHECKSUM.size]
        if CHECKSUM.unpack(data[-CHECKSUM.size :]) != (checksum(body),):
            self.counts.bad_checksums += 1
            return None
        return body

    def _is_repeated(self, sequence: int) -> bool:
        """Follow the sequence numbers and count what is missing between two of them."""
        step = 1 if self._sequence is None else (sequence - self._sequence) % SEQUENCE_WRAP
        self._sequence = sequence
        if step > MOST_LOST:
            self.counts.sequence_restarts += 1
        elif step > 1:
            self.counts.lost += step - 1
        return step == 0
