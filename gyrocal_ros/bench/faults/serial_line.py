"""Damaged bytes on the serial line of the board."""

from __future__ import annotations

from random import Random

from gyrocal_ros.bench.faults.bag_bytes import damaged_bytes
from gyrocal_ros.board.messages import Imu, Message, Supply, Wheels
from gyrocal_ros.board.protocol import encode
from gyrocal_ros.board.reader import BoardReader
from gyrocal_ros.config.robot_sections import BoardConfig

PACKETS = 300
BAUD_RATE = 115200


def feed_damaged_line(random: Random) -> int:
    """Feed valid packets, some with absurd contents, damaged and cut in pieces, to the receive path.

    Returns:
        0: any error raised is a finding.
    """
    line = b''.join(encode(_message(random), number % 256, number * 5000) for number in range(PACKETS))
    line = damaged_bytes(random, line)
    reader = BoardReader(BoardConfig(), BAUD_RATE)
    place, arrival_ns = 0, 10**18
    while place < len(line):
        length = random.choice((1, 7, 64, 4096))
        arrival_ns += random.choice((0, 10**6, 10**9, 10**12))
        reader.feed(line[place : place + length], arrival_ns)
        place += length
    return 0


def _message(random: Random) -> Message:
    large = random.random() < 0.1
    word, long_word = (2**15 - 1, 2**31 - 1) if large else (1000, 10_000)
    kind = random.randrange(3)

    def triple(limit: int) -> tuple[int, int, int]:
        return random.randint(-limit, limit), random.randint(-limit, limit), random.randint(-limit, limit)

    if kind == 0:
        return Imu(triple(long_word), triple(word), random.randint(-word, word))
    if kind == 1:
        return Wheels(random.randrange(long_word), random.randrange(long_word))
    return Supply(random.randrange(word), random.randint(-word, word))
