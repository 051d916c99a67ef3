"""Recordings of a few kilobytes that stand for gigabytes: they must be refused before they fill memory."""

from __future__ import annotations

import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from random import Random

from gyrocal_ros.bag.bounds import CHUNK, CHUNK_INDEX, MCAP_MAGIC
from gyrocal_ros.bag.decompress import zstd
from gyrocal_ros.bag.rewrite import rewrite_bag

BLOCK_BYTES, BLOCKS = 2**24, 128
"""Zeros that are compressed once, and the number of such frames in a bomb: 2 GB."""
HEADER, FOOTER, SCHEMA, CHANNEL, STATISTICS, DATA_END = 0x01, 0x02, 0x03, 0x04, 0x0B, 0x0F
"""Opcodes of records of mcap."""
REPEATED = 12
"""How often the index lists a chunk of 200 MB."""


def damage_by_bomb(random: Random, base: Path, folder: Path) -> Path:
    """Copy a bag and put a bomb into it."""
    return random.choice(BOMBS)(base, folder)


def _zeros() -> bytes:
    return bytes(zstd.compress(bytes(BLOCK_BYTES))) * BLOCKS


def _chunk(base: Path, folder: Path) -> Path:
    """A chunk that declares 1 MB."""
    return _mcap(base, folder, _zeros(), 2**20, 1)


def _overlapping_chunks(base: Path, folder: Path) -> Path:
    """Chunks below the limit, many for the same time."""
    size = 200 * 2**20
    ignored = struct.pack('<BQ', 0x80, size - 9) + bytes(size - 9)
    return _mcap(base, folder, bytes(zstd.compress(ignored)), size, REPEATED)


def _aliases(base: Path, folder: Path) -> Path:
    """Metadata whose aliases stand for 9^9 values."""
    bag = folder / 'bag'
    rewrite_bag(base, bag, lambda message: [message])
    file = bag / 'metadata.yaml'
    levels = [f'a{n}: &a{n} [{", ".join([f"*a{n - 1}" if n else "a"] * 9)}]\n' for n in range(9)]
    text = re.sub('compression_format:.*', 'compression_format: *a8', file.read_text(encoding='utf-8'))
    text = re.sub('compression_mode:.*', 'compression_mode: FILE', text)
    file.write_text(''.join(levels) + text, encoding='utf-8')
    return bag


def _message(base: Path, folder: Path) -> Path:
    """A compressed message."""
    bag, number = folder / 'bag', iter(range(10**9))
    rewrite_bag(
        base,
        bag,
        lambda message: [
            replace(message, content=_zeros() if next(number) == 50 else zstd.compress(message.content))
        ],
    )
    _declare_compression(bag, 'MESSAGE')
    return bag


def _file(base: Path, folder: Path) -> Path:
    """A compressed file."""
    bag = folder / 'bag'
    rewrite_bag(base, bag, lambda message: [message], 'sqlite3')
    file = next(bag.glob('*.db3'))
    file.with_name(f'{file.name}.zstd').write_bytes(zstd.compress(file.read_bytes()) + _zeros())
    file.unlink()
    _declare_compression(bag, 'FILE')
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text(encoding='utf-8')
    metadata.write_text(text.replace(file.name, f'{file.name}.zstd'), encoding='utf-8')
    return bag


def _table(base: Path, folder: Path) -> Path:
    """A table that calculates its messages."""
    bag = folder / 'bag'
    rewrite_bag(base, bag, lambda message: [message], 'sqlite3')
    with closing(sqlite3.connect(next(bag.glob('*.db3')))) as database:
        database.executescript(
            'ALTER TABLE messages RENAME TO before;'
            'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,'
            ' data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL);'
            'INSERT INTO messages(id, topic_id, timestamp) SELECT id, topic_id, timestamp FROM before;'
        )
    return bag


BOMBS: tuple[Callable[[Path, Path], Path], ...] = (
    _chunk,
    _overlapping_chunks,
    _aliases,
    _message,
    _file,
    _table,
)


def _declare_compression(bag: Path, mode: str) -> None:
    file = bag / 'metadata.yaml'
    text = re.sub('compression_format:.*', 'compression_format: zstd', file.read_text(encoding='utf-8'))
    file.write_text(re.sub('compression_mode:.*', f'compression_mode: {mode}', text), encoding='utf-8')


# --- mcap (https://mcap.dev/spec) ---------------------------------------------------------------


def _mcap(base: Path, folder: Path, content: bytes, declared: int, repeated: int) -> Path:
    """Write the topics of a bag as an mcap file with one chunk, which the index lists several times."""
    bag = folder / 'bag'
    rewrite_bag(base, bag, lambda message: [message])
    file = next(bag.glob('*.mcap'))
    records = list(_records(file.read_bytes()))
    kept = {opcode: [body for other, body in records if other == opcode] for opcode in (HEADER, STATISTICS)}
    topics = dict.fromkeys((o, body) for o, body in records if o in (SCHEMA, CHANNEL))
    start_ns, end_ns = struct.unpack_from('<QQ', kept[STATISTICS][0], 26)
    ids = [body[:2] for opcode, body in topics if opcode == CHANNEL]
    size, name = struct.pack('<Q', len(content)), _string(b'zstd')
    chunk = struct.pack('<QQQI', start_ns, end_ns, declared, 0) + name + size + content
    data = MCAP_MAGIC + _record(HEADER, kept[HEADER][0])
    places = _string(b''.join(number + struct.pack('<Q', len(data) + n) for n, number in enumerate(ids)))
    index = struct.pack('<QQQQ', start_ns, end_ns, len(data), 9 + len(chunk)) + places + bytes(8) + name
    index += size + struct.pack('<Q', declared)
    data += _record(CHUNK, chunk) + _record(DATA_END, bytes(4))
    summary = len(data)
    data += b''.join(_record(*topic) for topic in topics) + _record(STATISTICS, kept[STATISTICS][0])
    data += _record(CHUNK_INDEX, index) * repeated
    file.write_bytes(data + _record(FOOTER, struct.pack('<QQI', summary, 0, 0)) + MCAP_MAGIC)
    return bag


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    place = len(MCAP_MAGIC)
    while place < len(data) - len(MCAP_MAGIC):
        opcode, length = struct.unpack_from('<BQ', data, place)
        yield opcode, data[place + 9 : place + 9 + length]
        place += 9 + length


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack('<BQ', opcode, len(body)) + body


def _string(data: bytes) -> bytes:
    return struct.pack('<I', len(data)) + data
