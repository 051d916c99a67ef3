"""Resource limits: files and messages that would fill the memory are refused before they are read."""

from __future__ import annotations

import bz2
import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import cv2
import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
from small_bags import write

from gyrocal_ros.bag import bounds
from gyrocal_ros.bag.decompress import DECOMPRESSORS, decompressed, zstd
from gyrocal_ros.bag.storage import open_storage
from gyrocal_ros.bench.faults import bombs
from gyrocal_ros.config.yaml_file import read_yaml
from gyrocal_ros.errors import ConfigError, MessageError, RecordingError
from gyrocal_ros.msgs import images
from gyrocal_ros.msgs.image_size import declared_size

HEADER = Message(stamp=Message(sec=1, nanosec=0))


@pytest.mark.parametrize('suffix', ['.jpg', '.png'])
def test_the_declared_size_of_an_image_is_read(suffix: str) -> None:
    data = cv2.imencode(suffix, np.zeros((48, 64), np.uint8))[1].tobytes()
    assert declared_size(data) == (64, 48)


def test_an_image_that_declares_a_huge_size_is_refused() -> None:
    data = bytearray(cv2.imencode('.jpg', np.zeros((48, 64), np.uint8))[1].tobytes())
    place = data.index(b'\xff\xc0') + 5
    data[place : place + 4] = struct.pack('>HH', 30000, 30000)
    with pytest.raises(MessageError, match='30000x30000'):
        images.frame(Message(header=HEADER, data=bytes(data)))


@pytest.mark.parametrize('data', [b'', b'\xff\xd8', b'\xff\xd8\xff', b'BM' + bytes(60), bytes(100)])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError, match='jpeg or png'):
        images.frame(Message(header=HEADER, data=data))


@pytest.mark.parametrize(('width', 'height'), [(0, 4), (4, 0), (2**31, 2**31)])
def test_an_impossible_size_of_a_raw_image_is_refused(width: int, height: int) -> None:
    message = Message(
        header=HEADER, encoding='mono8', width=width, height=height, step=0, is_bigendian=0, data=b'\0' * 16
    )
    with pytest.raises(MessageError):
        images.frame(message)


def test_a_chunk_that_declares_gigabytes_is_refused(tmp_path: Path) -> None:
    file = tmp_path / 'a.mcap'
    body = struct.pack('<QQQII', 0, 0, 6 * 2**30, 0, 4) + b'zstd' + struct.pack('<Q', 0)
    file.write_bytes(bounds.MCAP_MAGIC + struct.pack('<BQ', bounds.CHUNK, len(body)) + body)
    with pytest.raises(RecordingError, match='chunk of more than 256 MB'), open_storage(file):
        pass


@pytest.mark.parametrize(
    ('frame', 'size'),
    [
        (b'\x28\xb5\x2f\xfd\xe0' + struct.pack('<Q', 6 * 2**30), 6 * 2**30),
        (b'\x28\xb5\x2f\xfd\x20\x07', 7),
        (b'\x28\xb5\x2f\xfd\x60\x01\x00', 257),
        (b'\x28\xb5\x2f\xfd\x00\x58\x00\x00', None),
        (b'none', None),
    ],
)
def test_the_size_that_a_zstd_frame_declares(frame: bytes, size: int | None) -> None:
    assert bounds.zstd_content_size(frame) == size


@pytest.mark.slow
@pytest.mark.parametrize('bomb', bombs.BOMBS, ids=lambda bomb: bomb.__name__)
def test_a_recording_that_stands_for_gigabytes_is_refused(
    bomb: Callable[[Path, Path], Path], tmp_path: Path
) -> None:
    bag = bomb(write(tmp_path / 'sound'), tmp_path)
    tracemalloc.start()
    with pytest.raises(RecordingError), open_storage(bag) as storage:
        list(storage.raw_messages(storage.topics.values()))
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 400e6


@pytest.mark.parametrize('make', DECOMPRESSORS.values(), ids=DECOMPRESSORS)
def test_decompression_ends_at_its_limit(make: Any) -> None:
    compress: Any = {
        bz2.BZ2Decompressor: bz2.compress,
        lz4.frame.LZ4FrameDecompressor: lz4.frame.compress,
    }.get(make, zstd.compress)
    frame = compress(bytes(5000))
    assert decompressed(make, frame + frame, 10_000) == bytes(10_000)
    assert decompressed(make, b'') == b''
    for limit in (0, 4999, 9999):
        with pytest.raises(ValueError, match=f'more than {limit} bytes'):
            decompressed(make, frame + frame, limit)
    with pytest.raises(ValueError, match='cut short'):
        decompressed(make, frame[:-2], 10_000)


@pytest.mark.parametrize('name', ['run #3', 'what?', 'a%20b'])
def test_a_path_that_sqlite_misreads_is_named(name: str, tmp_path: Path) -> None:
    bag = write(tmp_path / 'bag', storage='sqlite3').rename(tmp_path / name)
    with pytest.raises(RecordingError, match='SQLite reads'), open_storage(bag):
        pass
    with open_storage(write(tmp_path / f'{name} 2')) as storage:
        assert storage.message_count


def test_only_chunks_of_the_same_time_count_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    chunks: list[bounds.Chunk] = [(10, None), (10, (0, 5)), (10, (6, 9)), (10, (10, 0)), (5, (3, 4))]
    monkeypatch.setattr(bounds, '_chunks', lambda file: iter(chunks))
    monkeypatch.setattr(bounds, 'MAX_OPEN_BYTES', 15)
    file = tmp_path / 'a.mcap'
    file.touch()
    bounds.require_bounded(file)
    chunks.append((1, (4, 4)))
    with pytest.raises(RecordingError, match='for the same time'):
        bounds.require_bounded(file)


def test_a_pipe_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    bag = write(tmp_path / 'bag')
    (bag / 'metadata.yaml').unlink()
    os.mkfifo(bag / 'metadata.yaml')
    with pytest.raises(RecordingError, match='regular file'), open_storage(bag):
        pass
    with pytest.raises(ConfigError, match='not a file'):
        read_yaml(bag / 'metadata.yaml')


@pytest.mark.parametrize(
    'text',
    [
        'a: ' + '[' * 20_000,
        'a: ' + '[' * 51 + ']' * 51,
        'name: 2001-99-99',
        'a: &x [1, 2]\nb: [*x, *x]',
        'a: ' + '9' * 5000,
        'a: 0x' + 'zz',
        '? [a]\n: 1',
        '{}: {}',
        '- 1',
        '\x00',
    ],
    ids=range(10),
)
def test_yaml_of_a_stranger_is_refused_or_harmless(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'a.yaml'
    file.write_text(text)
    try:
        assert isinstance(read_yaml(file), dict)
    except ConfigError as error:
        assert '\n' not in str(error)
        assert str(file) in str(error)
    else:
        assert '0x' in text


def test_a_file_that_is_too_large_is_refused(tmp_path: Path) -> None:
    file = tmp_path / 'a.yaml'
    with file.open('wb') as stream:
        stream.truncate(17 * 2**20)
    with pytest.raises(ConfigError, match='more than 16 MB'):
        read_yaml(file)
