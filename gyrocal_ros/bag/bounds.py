"""Bounds of the files of a recording, checked before they are read: a few bytes must not become gigabytes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from gyrocal_ros.errors import RecordingError

MAX_CHUNK_BYTES = 256 * 2**20
"""Largest uncompressed chunk of an mcap file; rosbag2 writes chunks of 0.8 MB, cameras need a few MB."""
MAX_METADATA_BYTES = 16 * 2**20
"""Largest metadata.yaml."""
CHUNK = 0x06
"""Opcode of a chunk record of mcap."""
MCAP_MAGIC = b'\x89MCAP0\r\n'


def require_bounded(path: Path) -> None:
    """Raise an error if a file of a recording is no regular file, or would be too large in memory.

    Args:
        path: a rosbag2 folder, or one file.

    Raises:
        RecordingError: a file exceeds a limit.
        OSError: a file cannot be read.
    """
    for file in _files(path):
        if not file.is_file():
            raise RecordingError('is not a regular file', where=str(file), todo='copy the recording again')
        if file.suffix == '.yaml' and file.stat().st_size > MAX_METADATA_BYTES:
            raise RecordingError('is far too large', where=str(file), todo='run: ros2 bag reindex')
        if file.suffix == '.mcap' and max(_chunk_sizes(file), default=0) > MAX_CHUNK_BYTES:
            what = f'has a chunk of more than {MAX_CHUNK_BYTES // 2**20} MB'
            raise RecordingError(what, where=str(file), todo='record it with smaller chunks')


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return [file for file in path.iterdir() if file.suffix in ('.yaml', '.mcap', '.db3')]


def _chunk_sizes(file: Path) -> Iterator[int]:
    """Yield the uncompressed sizes of the chunks of an mcap file, by their headers and their contents."""
    with file.open('rb') as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return
        while len(head := stream.read(9)) == 9:
            opcode, length = struct.unpack('<BQ', head)
            start = stream.tell()
            if opcode == CHUNK:
                yield from _sizes_of_chunk(stream)
            stream.seek(start + min(length, 2**62))


def _sizes_of_chunk(stream: BinaryIO) -> Iterator[int]:
    """Yield the size that a chunk declares, and the one that its compressed content declares."""
    head = stream.read(32)
    if len(head) < 32:
        return
    yield int(struct.unpack_from('<Q', head, 16)[0])
    compression = stream.read(min(struct.unpack_from('<I', head, 28)[0], 16))
    stream.read(8)  # length of the content
    content = stream.read(18)  # the longest header of a zstd frame
    if compression == b'zstd' and (size := zstd_content_size(content)) is not None:
        yield size


def zstd_content_size(frame: bytes) -> int | None:
    """Return the content size that a zstd frame declares (RFC 8878, 3.1.1.1); None if it declares none."""
    if len(frame) < 6 or frame[:4] != b'\x28\xb5\x2f\xfd':
        return None
    descriptor = frame[4]
    is_single = bool(descriptor & 0x20)
    width = (1 if is_single else 0, 2, 4, 8)[descriptor >> 6]
    start = 5 + (0 if is_single else 1) + (0, 1, 2, 4)[descriptor & 3]
    if not width or len(frame) < start + width:
        return None
    return int.from_bytes(frame[start : start + width], 'little') + (256 if width == 2 else 0)
