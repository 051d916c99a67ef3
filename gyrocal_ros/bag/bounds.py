"""Bounds of the files of a recording, checked before they are read: a few bytes must not become gigabytes."""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO, TypeAlias

import yaml

from gyrocal_ros.bag.decompress import MAX_BYTES
from gyrocal_ros.config.yaml_file import require_tree
from gyrocal_ros.errors import RecordingError

MAX_CHUNK_BYTES = MAX_BYTES
"""Largest uncompressed chunk of an mcap file; rosbag2 writes chunks of 0.8 MB, cameras need a few MB."""
MAX_OPEN_BYTES = 2 * MAX_CHUNK_BYTES
"""Largest size of all chunks of one time: those of an index are read together if their times overlap."""
MAX_METADATA_BYTES = 16 * 2**20
"""Largest metadata.yaml."""
CHUNK, CHUNK_INDEX = 0x06, 0x08
"""Opcodes of records of mcap."""
MAX_INDEX_BYTES = 2**20
"""Largest record of the index that is looked at; one of 1000 topics has 10 kB."""
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
        if file.suffix == '.yaml':
            _require_plain_yaml(file)
        elif file.suffix == '.mcap':
            _require_bounded_chunks(file)
        elif file.suffix == '.db3':
            _require_plain_tables(file)


def _require_plain_yaml(file: Path) -> None:
    """Refuse metadata that are large or have aliases, which may stand for billions of values."""
    if file.stat().st_size > MAX_METADATA_BYTES:
        raise RecordingError('is far too large', where=str(file), todo='run: ros2 bag reindex')
    content = file.read_bytes()
    if b'&' not in content:  # an alias needs an anchor
        return
    try:
        require_tree(content.decode('utf-8'))
    except (yaml.YAMLError, ValueError) as error:
        what = f'is not valid YAML ({" ".join(str(error).split())})'
        raise RecordingError(what, where=str(file), todo='run: ros2 bag reindex') from error


def _require_bounded_chunks(file: Path) -> None:
    """Refuse an mcap file with a huge chunk, or with many that are read together."""
    changes: list[tuple[int, int]] = []
    for size, span in _chunks(file):
        if size > MAX_CHUNK_BYTES:
            what = f'has a chunk of more than {MAX_CHUNK_BYTES // 2**20} MB'
            raise RecordingError(what, where=str(file), todo='record it with smaller chunks')
        if span:
            changes += [(span[0], size), (max(span) + 1, -size)]
    changes.sort()
    if max(accumulate(size for _, size in changes), default=0) > MAX_OPEN_BYTES:
        what = f'has chunks of more than {MAX_OPEN_BYTES // 2**20} MB for the same time'
        raise RecordingError(what, where=str(file), todo='record it with smaller chunks')


def _require_plain_tables(file: Path) -> None:
    """Refuse a data base of SQLite that rosbags cannot open, or whose messages are huge or calculated."""
    if re.search(r'[?#]|%[0-9a-fA-F]{2}', str(file)):
        what = 'cannot be opened: SQLite reads ?, # and % in a path as parts of an address'
        raise RecordingError(what, where=str(file), todo='move the recording to another path')
    try:
        with closing(sqlite3.connect(f'file:{file}?immutable=1', uri=True)) as database:
            is_calculated = any(row[6] for row in database.execute('PRAGMA table_xinfo(messages)'))
            sizes = 'SELECT max(length(data)) FROM messages'
            size = 0 if is_calculated else database.execute(sizes).fetchone()[0]
    except sqlite3.Error:
        return  # rosbags says what is wrong
    if is_calculated:
        raise RecordingError('calculates its messages', where=str(file), todo='record it again')
    if isinstance(size, int) and size > MAX_BYTES:
        what = f'has a message of more than {MAX_BYTES // 2**20} MB'
        raise RecordingError(what, where=str(file), todo='record it again')


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return [file for file in path.iterdir() if file.suffix in ('.yaml', '.mcap', '.db3')]


Chunk: TypeAlias = tuple[int, tuple[int, int] | None]
"""Uncompressed size of a chunk, and its first and last time (ns) if it is in the index."""


def _chunks(file: Path) -> Iterator[Chunk]:
    """Yield the chunks of an mcap file: by their headers, by their contents, and by the index."""
    with file.open('rb') as stream:
        if stream.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return
        while len(head := stream.read(9)) == 9:
            opcode, length = struct.unpack('<BQ', head)
            start = stream.tell()
            if opcode == CHUNK:
                yield from _chunk(stream)
            elif opcode == CHUNK_INDEX:
                yield from _indexed_chunk(stream.read(min(length, MAX_INDEX_BYTES)))
            stream.seek(start + min(length, 2**62))


def _chunk(stream: BinaryIO) -> Iterator[Chunk]:
    """Yield the size that a chunk declares, and the one that its compressed content declares."""
    head = stream.read(32)
    if len(head) < 32:
        return
    yield int(struct.unpack_from('<Q', head, 16)[0]), None
    compression = stream.read(min(struct.unpack_from('<I', head, 28)[0], 16))
    stream.read(8)  # length of the content
    content = stream.read(18)  # the longest header of a zstd frame
    if compression == b'zstd' and (size := zstd_content_size(content)) is not None:
        yield size, None


def _indexed_chunk(record: bytes) -> Iterator[Chunk]:
    """Yield the size and the times of a chunk by its record in the index."""
    try:
        span = struct.unpack_from('<QQ', record)
        place = 36 + struct.unpack_from('<I', record, 32)[0] + 8
        place += 4 + struct.unpack_from('<I', record, place)[0] + 8
        yield int(struct.unpack_from('<Q', record, place)[0]), span
    except struct.error:
        return  # rosbags says what is wrong


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
