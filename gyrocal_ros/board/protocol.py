"""Framing of packets without IO: COBS frames with a checksum.

    frame = COBS(type u8 | sequence u16 | time u32 | message | checksum u16) 00

COBS (consistent overhead byte stuffing) removes all zeros from a frame, so that a zero byte always ends
a frame: after lost or corrupted bytes, the next frame begins after the next zero. The checksum is
CRC-16/CCITT in the variant CRC-16/IBM-3740, also known as CCITT-FALSE: polynomial 1021, start FFFF, not
reflected, not inverted; its check value for the nine characters `123456789` is 29B1.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass

from gyrocal_ros.board.messages import LAYOUTS, MAX_MESSAGE_SIZE, Message, pack, unpack

HEADER = struct.Struct('<BHI')
"""Type, sequence number, board time."""
CHECKSUM = struct.Struct('<H')
MAX_FRAME_SIZE = HEADER.size + MAX_MESSAGE_SIZE + CHECKSUM.size + 1
"""Size of the longest frame in bytes, without the zero at its end; COBS adds one byte at this length."""
BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""
SEQUENCE_WRAP = 1 << 16
TIME_WRAP = 1 << 32
MAX_LOST = 4096
"""Largest step of the sequence number that is a loss; a larger step is a restart of the count."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One received message with its header."""

    sequence: int
    """Frame counter of the sender; 16 bits, wraps."""
    time_us: int
    """Board time of the measurement; 32 bits, wraps after 71.6 minutes. 0 in commands."""
    message: Message


@dataclass(slots=True)
class Counts:
    """Counters of everything received since the start.

    Each non-empty piece between two zeros is counted once, under `packets`, `repeated`, `unknown`,
    `malformed` or `bad_checksums`.
    """

    packets: int = 0
    """Packets delivered."""
    repeated: int = 0
    """Valid frames with the sequence number of the previous frame; discarded."""
    unknown: int = 0
    """Valid frames of a type or length that the table does not contain; discarded."""
    malformed: int = 0
    """Pieces that are not frames: truncated, too short, too long, or noise."""
    bad_checksums: int = 0
    """Well-formed frames with a wrong checksum."""
    resyncs: int = 0
    """Number of valid frames that followed an invalid piece."""
    lost: int = 0
    """Frames not received intact, from the steps of the sequence number."""
    sequence_restarts: int = 0
    """Steps too large to be a loss: the board was restarted, or was disconnected for long."""


def checksum(data: bytes) -> int:
    """Return the CRC-16/IBM-3740 of some bytes."""
    return crc_hqx(data, 0xFFFF)


def cobs_encode(data: bytes) -> bytes:
    """Encode fewer than 254 bytes by COBS; the zero that ends a frame is not included."""
    return b''.join(bytes((len(piece) + 1,)) + piece for piece in data.split(b'\0'))


def cobs_decode(frame: bytes) -> bytes | None:
    """Decode COBS, the inverse of `cobs_encode`; return None if the bytes are not a valid encoding."""
    pieces = []
    while frame:
        code = frame[0]
        if code > len(frame):
            return None
        pieces.append(frame[1:code])
        frame = frame[code:]
    return b'\0'.join(pieces)


def encode(message: Message, sequence: int, time_us: int = 0) -> bytes:
    """Return the frame of a message, including the zero at its end.

    Args:
        message: the message to send.
        sequence: number of frames sent before; it is truncated to 16 bits.
        time_us: time of measurement in microseconds; it is truncated to 32 bits.

    Raises:
        ValueError: a value of the message does not fit into its field.
    """
    body = HEADER.pack(message.TYPE, sequence % SEQUENCE_WRAP, time_us % TIME_WRAP) + pack(message)
    return cobs_encode(body + CHECKSUM.pack(checksum(body))) + b'\0'


def wire_time_s(kind: type[Message], baud_rate: int) -> float:
    """Return the transmission time of a frame, from its first bit to the last bit of its zero."""
    size = HEADER.size + LAYOUTS[kind.TYPE].code.size + CHECKSUM.size + 2
    return size * BITS_PER_BYTE / baud_rate


class Decoder:
    """Decodes bytes, received in portions of any size, to intact packets.

    The packets and all counts depend only on the bytes, not on the portions. No input raises an error.

    Args:
        on_unknown: called with type and sequence number of a valid frame that the table does not
            contain.
    """

    def __init__(self, on_unknown: Callable[[int, int], None] = lambda kind, sequence: None) -> None:
        self._on_unknown = on_unknown
        self.counts = Counts()
        self._buffer = b''
        self._in_sync = True
        self._skips_partial = False
        self._sequence: int | None = None

    def skip_partial_frame(self) -> None:
        """Discard buffered bytes and skip the next bytes up to a zero, uncounted.

        On a running line the first bytes may be the rest of a frame.
        """
        self._buffer, self._skips_partial = b'', True

    def feed(self, data: bytes) -> list[Packet]:
        """Process the next bytes and return the packets that they complete, in order."""
        *frames, rest = (self._buffer + data).split(b'\0')
        if frames and self._skips_partial:
            self._skips_partial = False
            del frames[0]
        self._buffer = rest[: MAX_FRAME_SIZE + 1]  # enough bytes to detect that it is too long
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
        """Return header and message of a frame, or None if it is not intact."""
        data = cobs_decode(frame) if len(frame) <= MAX_FRAME_SIZE else None
        if data is None or len(data) < HEADER.size + CHECKSUM.size:
            self.counts.malformed += 1
            return None
        body = data[: -CHECKSUM.size]
        if CHECKSUM.unpack(data[-CHECKSUM.size :]) != (checksum(body),):
            self.counts.bad_checksums += 1
            return None
        return body

    def _is_repeated(self, sequence: int) -> bool:
        """Return whether a frame is a repetition, and count the frames missing before it."""
        step = 1 if self._sequence is None else (sequence - self._sequence) % SEQUENCE_WRAP
        self._sequence = sequence
        if step > MAX_LOST:
            self.counts.sequence_restarts += 1
        elif step > 1:
            self.counts.lost += step - 1
        return step == 0
