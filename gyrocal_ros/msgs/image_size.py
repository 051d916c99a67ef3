"""Size of a compressed image, read from its header without decoding it.

ITU-T T.81 (JPEG), annex B: markers of two bytes, each followed by the length of its segment. The frame
header SOFn holds height and width. PNG (ISO/IEC 15948), 11.2.2: IHDR comes first.
"""

from __future__ import annotations

import struct

from gyrocal_ros.errors import MessageError

PNG_SIGNATURE = b'\x89PNG\r\n\x1a\n'
JPEG_START = b'\xff\xd8'
FRAME_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""SOF0 to SOF15 without DHT, JPG and DAC."""
LONE_MARKERS = {0x01, *range(0xD0, 0xD8)}
"""Markers without a segment."""


def declared_size(data: bytes) -> tuple[int, int]:
    """Return width and height by the header of a JPEG or PNG image.

    Raises:
        MessageError: the data are no JPEG or PNG image.
    """
    size = None
    if data.startswith(PNG_SIGNATURE) and len(data) >= 24:
        size = struct.unpack_from('>II', data, 16)
    elif data.startswith(JPEG_START):
        size = _jpeg_size(data)
    if size is None:
        raise MessageError('a compressed image cannot be decoded', todo='record jpeg or png images')
    return size[0], size[1]


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    place = len(JPEG_START)
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker == 0xFF:  # a fill byte
            place += 1
        elif marker in LONE_MARKERS:
            place += 2
        elif marker in FRAME_MARKERS:
            height, width = struct.unpack_from('>HH', data, place + 5)
            return width, height
        else:
            place += 2 + int(struct.unpack_from('>H', data, place + 2)[0])
    return None
