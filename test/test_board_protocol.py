"""The wire protocol: every intact frame is decoded, whatever else is received."""

from __future__ import annotations

import ctypes
import random
import re
import shutil
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.board.messages import (
    LAYOUTS,
    MESSAGES,
    Acknowledgement,
    CommandResult,
    Imu,
    Layout,
    Message,
    SetRates,
    Supply,
    Wheels,
    Zero,
    pack,
    unpack,
)
from gyrocal_ros.board.protocol import (
    MAX_FRAME_SIZE,
    MAX_LOST,
    Counts,
    Decoder,
    Packet,
    checksum,
    cobs_decode,
    cobs_encode,
    encode,
)

PAGE = (Path(__file__).resolve().parent.parent / 'docs/board_protocol.md').read_text(encoding='utf-8')
SEEDS = range(30)
LIMITS = {'u8': (0, 0xFF), 'u16': (0, 0xFFFF), 'i16': (-0x8000, 0x7FFF), 'i32': (-(2**31), 2**31 - 1)}


def random_message(rng: random.Random) -> Message:
    layout = rng.choice(list(LAYOUTS.values()))
    limits = [LIMITS[wire_format.kind] for _, wire_format in layout.columns for _ in range(wire_format.count)]
    return layout.build(rng.choice((0, low, high, rng.randint(low, high))) for low, high in limits)


def random_packets(rng: random.Random, count: int, first: int = 65_500) -> list[Packet]:
    """Return consecutive packets whose sequence numbers wrap."""
    return [Packet((first + i) % 65_536, rng.randrange(1 << 32), random_message(rng)) for i in range(count)]


def frames_of(packets: Iterable[Packet]) -> list[bytes]:
    return [encode(packet.message, packet.sequence, packet.time_us) for packet in packets]


def portions(rng: random.Random, data: bytes) -> Iterable[bytes]:
    while data:
        size = rng.choice((1, 2, 7, 31, 200))
        yield data[:size]
        data = data[size:]


def decoded(chunks: Iterable[bytes]) -> tuple[list[Packet], Counts]:
    decoder = Decoder()
    packets = [packet for chunk in chunks for packet in decoder.feed(chunk)]
    return packets, decoder.counts


def pieces(data: bytes) -> int:
    """Return the number of non-empty pieces between zeros; what follows the last zero is not complete."""
    return sum(bool(piece) for piece in data.split(b'\0')[:-1])


def accounted(counts: Counts) -> int:
    return counts.packets + counts.repeated + counts.unknown + counts.malformed + counts.bad_checksums


def is_subsequence(packets: list[Packet], others: list[Packet]) -> bool:
    """Return whether `packets` are among the others, in the same order."""
    remaining = iter(others)
    return all(packet in remaining for packet in packets)


# --- intact frames --------------------------------------------------------------------------------


@pytest.mark.parametrize('seed', SEEDS)
def test_packets_are_decoded_from_any_portions(seed: int) -> None:
    rng = random.Random(seed)
    sent = random_packets(rng, 100)
    received, counts = decoded(portions(rng, b''.join(frames_of(sent))))
    assert received == sent
    assert counts == Counts(packets=100)


@pytest.mark.parametrize('seed', SEEDS)
def test_encoded_bytes_contain_no_zero_and_can_be_decoded(seed: int) -> None:
    rng = random.Random(seed)
    data = bytes(rng.choice((0, 1, 255, rng.randrange(256))) for _ in range(rng.randrange(1, 254)))
    assert 0 not in cobs_encode(data)
    assert len(cobs_encode(data)) == len(data) + 1
    assert cobs_decode(cobs_encode(data)) == data


def test_no_frame_is_longer_than_the_maximum() -> None:
    rng = random.Random(0)
    assert max(len(frame) - 1 for frame in frames_of(random_packets(rng, 200))) == MAX_FRAME_SIZE


def test_sequence_and_time_are_truncated_to_their_bits() -> None:
    [packet], _ = decoded([encode(Zero(10), 65_536 + 7, (1 << 32) + 9)])
    assert (packet.sequence, packet.time_us) == (7, 9)


@pytest.mark.parametrize('message', [Wheels(2**31, 0), Supply(-1, 0), Imu((0, 0, 0), (0, 0, 40_000), 0)])
def test_a_value_that_does_not_fit_is_refused(message: Message) -> None:
    with pytest.raises(ValueError, match='does not fit'):
        encode(message, 0)


def test_every_message_has_its_own_type() -> None:
    assert len(LAYOUTS) == len(MESSAGES)


def test_a_message_of_another_length_is_not_unpacked() -> None:
    message = Supply(1, 2)
    assert unpack(Supply.TYPE, pack(message)) == message
    assert unpack(Supply.TYPE, pack(message) + b'\1') is None
    assert unpack(0x7F, pack(message)) is None


# --- corrupted frames -----------------------------------------------------------------------------


def flip(rng: random.Random, frame: bytes) -> bytes:
    place = rng.randrange(len(frame))
    return frame[:place] + bytes((frame[place] ^ (1 << rng.randrange(8)),)) + frame[place + 1 :]


def drop(rng: random.Random, frame: bytes) -> bytes:
    place = rng.randrange(len(frame))
    return frame[:place] + frame[place + 1 :]


def duplicate(rng: random.Random, frame: bytes) -> bytes:
    place = rng.randrange(len(frame))
    return frame[:place] + frame[place : place + 1] + frame[place:]


def cut(rng: random.Random, frame: bytes) -> bytes:
    return frame[: rng.randrange(len(frame))]


def noise(rng: random.Random, frame: bytes) -> bytes:
    return rng.randbytes(rng.randrange(1, 80)) + frame


@pytest.mark.parametrize('corrupt', [flip, drop, duplicate, cut, noise])
@pytest.mark.parametrize('seed', SEEDS)
def test_every_intact_frame_is_decoded_among_corrupted_ones(
    seed: int, corrupt: Callable[[random.Random, bytes], bytes]
) -> None:
    rng = random.Random(seed)
    sent = random_packets(rng, 200)
    frames = frames_of(sent)
    corrupted = [i > 0 and rng.random() < 0.2 for i in range(len(frames))]
    corrupted[-1] = False
    line = [corrupt(rng, frame) if bad else frame for frame, bad in zip(frames, corrupted, strict=True)]
    data = b''.join(line)
    received, counts = decoded(portions(rng, data))
    # A frame is intact if all its bytes were received and the previous frame ended in its zero.
    intact = [
        packet
        for i, packet in enumerate(sent)
        if line[i] == frames[i] and (i == 0 or line[i - 1].endswith(b'\0'))
    ]
    assert is_subsequence(intact, received)
    assert is_subsequence(received, sent)
    assert accounted(counts) == pieces(data)
    missing_before_last = sent.index(received[-1]) + 1 - len(received)
    assert counts.lost == missing_before_last
    assert counts.sequence_restarts == 0
    assert 0 < counts.resyncs <= counts.malformed + counts.bad_checksums


@pytest.mark.parametrize('seed', SEEDS)
def test_the_portions_change_neither_packets_nor_counts(seed: int) -> None:
    rng = random.Random(seed)
    data = b''.join(noise(rng, flip(rng, frame)) + frame for frame in frames_of(random_packets(rng, 60)))
    assert decoded(portions(rng, data)) == decoded([data])


@pytest.mark.parametrize('zeros', [1 / 256, 1 / 20])
def test_random_bytes_never_raise_and_the_next_intact_frame_is_decoded(zeros: float) -> None:
    """Feed ten million bytes; with more zeros than chance has, more pieces have the length of a frame."""
    rng, decoder = np.random.default_rng(1), Decoder()
    sent = random_packets(random.Random(1), 100)
    for packet, frame in zip(sent, frames_of(sent), strict=True):
        noise = rng.integers(1, 256, 100_000, dtype=np.uint8)
        noise[rng.random(len(noise)) < zeros] = 0
        decoder.feed(noise.tobytes())
        assert decoder.feed(b'\0' + frame) == [packet]
    assert decoder.counts.malformed > 30_000
    assert decoder.counts.packets == 100


def test_every_prefix_of_a_stream_yields_its_intact_frames_and_all_that_follow() -> None:
    sent = random_packets(random.Random(1), 13)
    *frames, last = frames_of(sent)
    data = b''.join(frames)
    ends = [sum(map(len, frames[: i + 1])) for i in range(len(frames))]
    for length in range(len(data) + 1):
        decoder = Decoder()
        assert decoder.feed(data[:length]) == sent[: sum(end <= length for end in ends)]
        follow = decoder.feed(last + b'\0' + last)  # a truncated frame may corrupt the next one
        assert follow == [sent[-1]]


def test_a_skipped_partial_frame_is_not_counted() -> None:
    sent = random_packets(random.Random(1), 4)
    frames = frames_of(sent)
    decoder = Decoder()
    decoder.feed(frames[0] + frames[1][:5])
    decoder.skip_partial_frame()
    assert decoder.feed(frames[2][7:9]) == []
    assert decoder.feed(frames[2][9:] + frames[3]) == [sent[3]]
    assert decoder.counts == Counts(packets=2, lost=2)


def test_an_endless_frame_is_one_malformed_frame_and_is_not_buffered() -> None:
    packet = random_packets(random.Random(2), 1)[0]
    decoder = Decoder()
    for _ in range(1000):
        assert not decoder.feed(b'\x55' * 100)
    assert decoder.feed(b'\0' + frames_of([packet])[0]) == [packet]
    assert decoder.counts == Counts(packets=1, malformed=1, resyncs=1)


# --- sequence numbers -----------------------------------------------------------------------------


def counts_of_sequences(*sequences: int) -> Counts:
    return decoded(encode(Zero(1), sequence) for sequence in sequences)[1]


def test_gaps_are_counted_as_losses_also_over_the_wrap() -> None:
    assert counts_of_sequences(10, 11, 14) == Counts(packets=3, lost=2)
    assert counts_of_sequences(65_534, 1) == Counts(packets=2, lost=2)


def test_a_repeated_frame_is_discarded_and_counted() -> None:
    assert counts_of_sequences(5, 5, 6) == Counts(packets=2, repeated=1)


def test_a_large_step_is_a_restart_and_not_a_loss() -> None:
    assert counts_of_sequences(9000, 0, 1) == Counts(packets=3, sequence_restarts=1)
    assert counts_of_sequences(0, MAX_LOST, 2 * MAX_LOST + 1).sequence_restarts == 1


def test_a_valid_frame_of_an_unknown_type_is_counted_and_discarded() -> None:
    body = bytes((0x7F, 1, 0, 0, 0, 0, 0, 42))
    frame = cobs_encode(body + checksum(body).to_bytes(2, 'little')) + b'\0'
    reported = []
    decoder = Decoder(lambda kind, sequence: reported.append((kind, sequence)))
    packets, counts = decoder.feed(encode(Zero(1), 0) + frame + encode(Zero(1), 2)), decoder.counts
    assert reported == [(0x7F, 1)]
    assert [packet.sequence for packet in packets] == [0, 2]
    assert counts == Counts(packets=2, unknown=1)


# --- the protocol page ----------------------------------------------------------------------------


def rows(heading: str) -> list[list[str]]:
    """Return the cells of every table row below a heading of the page, up to the next heading."""
    section = re.split(rf'^#+ {re.escape(heading)}$', PAGE, flags=re.MULTILINE)[1]
    lines = re.split(r'^#', section, flags=re.MULTILINE)[0].splitlines()
    table = [
        [cell.strip().strip('`') for cell in line.strip('|').split('|')] for line in lines if '|' in line
    ]
    return [row for row in table if set(row[0]) != {'-'}]


VECTORS = [row for row in rows('Test vectors') if row[0] in {message.__name__ for message in MESSAGES}]
REFUSED = [row for row in rows('Test vectors') if row[1] in {item.name for item in fields(Counts)}]


def test_the_page_has_vectors_of_every_message_and_every_fault() -> None:
    assert {row[0] for row in VECTORS} == {message.__name__ for message in MESSAGES}
    assert {row[1] for row in REFUSED} == {'bad_checksums', 'malformed', 'unknown'}


@pytest.mark.parametrize('row', VECTORS, ids=lambda row: f'{row[0]} {row[2]}')
def test_the_vectors_of_the_page_are_decoded(row: list[str]) -> None:
    name, values, sequence, time_us, frame = row
    [packet], counts = decoded([bytes.fromhex(frame)])
    assert type(packet.message).__name__ == name
    assert LAYOUTS[packet.message.TYPE].numbers(packet.message) == [int(value) for value in values.split()]
    assert (packet.sequence, packet.time_us) == (int(sequence), int(time_us))
    assert counts == Counts(packets=1)
    assert frames_of([packet]) == [bytes.fromhex(frame)]


@pytest.mark.parametrize('row', REFUSED, ids=lambda row: row[2])
def test_the_invalid_frames_of_the_page_are_discarded(row: list[str]) -> None:
    packets, counts = decoded([bytes.fromhex(row[0])])
    assert not packets
    assert counts == replace(Counts(), **{row[1]: 1})


@pytest.mark.parametrize('layout', LAYOUTS.values(), ids=lambda layout: layout.message.__name__)
def test_the_page_has_the_layout_of_every_message(layout: Layout) -> None:
    message, code = layout.message, layout.code
    table = rows(f'`{message.__name__}`, type {message.TYPE:02x}, {code.size} bytes')
    described, offset = [['offset', 'field', 'type', 'unit', 'meaning']], 0
    for name, wire_format in layout.columns:
        kind = wire_format.kind if wire_format.count == 1 else f'{wire_format.kind} x {wire_format.count}'
        described.append([str(offset), name, kind, wire_format.unit, wire_format.help.replace('`', '')])
        offset += wire_format.count * int(wire_format.kind[1:]) // 8
    assert [[cell.replace('`', '') for cell in row] for row in table] == described
    assert offset == code.size


def test_the_page_has_the_other_numbers() -> None:
    assert f'Of the nine ASCII bytes `123456789` it is `{checksum(b"123456789"):04x}`' in PAGE
    assert f'The longest frame has {MAX_FRAME_SIZE} bytes' in ' '.join(PAGE.split())
    assert f'A step of up to {MAX_LOST} is a loss' in ' '.join(PAGE.split())
    assert (
        ', '.join(f'{result.value} {result.name.lower().replace("_", " ")}' for result in CommandResult)
        in PAGE
    )
    assert Acknowledgement(7, SetRates.TYPE, CommandResult.DONE) in [
        packet.message for row in VECTORS for packet in decoded([bytes.fromhex(row[4])])[0]
    ]


@pytest.mark.skipif(shutil.which('cc') is None, reason='no C compiler to try the code of the page with')
def test_the_c_code_of_the_page_encodes_its_vectors(tmp_path: Path) -> None:
    [code] = re.findall(r'^```c\n(.*?)^```', PAGE, flags=re.MULTILINE | re.DOTALL)
    library = tmp_path / 'frame.so'
    (tmp_path / 'frame.c').write_text(code)
    command = ['cc', '-std=c99', '-Wall', '-Wextra', '-Werror', '-shared', '-fPIC', '-o', str(library)]
    subprocess.run([*command, str(tmp_path / 'frame.c')], check=True)
    make_frame = ctypes.CDLL(str(library)).make_frame
    make_frame.restype = ctypes.c_size_t
    for row in VECTORS:
        frame = bytes.fromhex(row[4])
        plain = cobs_decode(frame[:-1])
        assert plain is not None
        made = ctypes.create_string_buffer(256)
        size = make_frame(plain[:-2], ctypes.c_size_t(len(plain) - 2), made)
        assert made.raw[:size] == frame
