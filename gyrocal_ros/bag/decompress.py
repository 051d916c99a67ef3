"""Decompression with a bound, in place of that of rosbags: a few bytes must not become gigabytes.

rosbags decompresses a chunk as far as it goes and compares its size with the declared one afterwards, and
messages and files without any limit. Its decompressors are replaced here, when this module is imported.
"""

from __future__ import annotations

import bz2
import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, Protocol

import lz4.frame  # type: ignore[import-untyped]

MAX_BYTES = 256 * 2**20
"""Largest decompressed chunk or message."""
MAX_FILE_RATIO, MIN_FILE_BYTES = 1000, 2**30
"""A compressed file may grow by this factor, and in any case to this size."""


class Decompressor(Protocol):
    """The decompressors of bz2, lz4 and zstd."""

    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def decompressed(make: Callable[[], Decompressor], data: bytes, limit: int = MAX_BYTES) -> bytes:
    """Return the decompressed data, of one frame or of several one after the other.

    Args:
        make: makes a decompressor, which reads one frame.
        data: the compressed data.
        limit: largest size of the result, in bytes.

    Raises:
        ValueError: the result is larger, or the data are cut short.
    """
    parts, left = [], limit
    while data:
        decompressor = make()
        parts.append(decompressor.decompress(data, left + 1))
        left -= len(parts[-1])
        if left < 0:
            raise ValueError(f'compressed data expand to more than {limit} bytes')
        if not decompressor.eof:
            raise ValueError('compressed data are cut short')
        data = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b''.join(parts)


@contextmanager
def opened(file: BinaryIO, mode: str) -> Iterator[Any]:
    """Open a compressed file for reading, of which no more is read than its limit.

    Raises:
        ValueError: from `read`, if the file expands to more.
    """
    limit = max(MIN_FILE_BYTES, MAX_FILE_RATIO * Path(file.name).stat().st_size)
    with zstd.open(file, mode) as content:

        def read(size: int) -> bytes:
            if content.tell() > limit:
                raise ValueError(f'a compressed file expands to more than {limit} bytes')
            return bytes(content.read(size))

        yield SimpleNamespace(read=read)


rosbag1: Any = importlib.import_module('rosbags.rosbag1.reader')
rosbag2: Any = importlib.import_module('rosbags.rosbag2.reader')
mcap: Any = importlib.import_module('rosbags.rosbag2.storage_mcap')
zstd = mcap.zstd

DECOMPRESSORS: dict[str, Callable[[], Decompressor]] = {
    'bz2': bz2.BZ2Decompressor,
    'lz4': lz4.frame.LZ4FrameDecompressor,
    'zstd': zstd.ZstdDecompressor,
}
BOUNDED = {name: partial(decompressed, make) for name, make in DECOMPRESSORS.items()}

mcap.DECOMPRESSORS |= {name: BOUNDED[name] for name in ('lz4', 'zstd')}
rosbag1.decompressors |= {name: BOUNDED[name] for name in ('bz2', 'lz4')}
rosbag2.zstd = SimpleNamespace(open=opened, decompress=BOUNDED['zstd'])
