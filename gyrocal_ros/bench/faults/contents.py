"""Damage to the serialised messages of a bag, and to the numbers and stamps in them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

from gyrocal_ros.bag.rewrite import RawMessage, decode, encode, rewrite_bag
from gyrocal_ros.bench.faults.bag_bytes import damaged_bytes
from gyrocal_ros.msgs import topics

STRANGE_NUMBERS = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e30, 5e-324, 1e6, -1.0, 0.0)
SHARES = (1e-3, 0.02, 0.3, 1.0)
"""Shares of the messages of a topic that are damaged."""


def damaged_copy(
    random: Random,
    base: Path,
    folder: Path,
    kinds: Iterable[str],
    change: Callable[[Random, RawMessage], bytes],
) -> Path:
    """Copy a bag and damage a share of the messages of one of some types, at least the first one.

    Args:
        random: the random numbers.
        base: the bag.
        folder: folder of the copy.
        kinds: names of message types, of which one is chosen.
        change: returns the damaged content of a message.
    """
    kind, share = random.choice(sorted(kinds)), random.choice(SHARES)
    count = 0

    def changed(message: RawMessage) -> list[RawMessage]:
        nonlocal count
        if message.type_name != kind:
            return [message]
        count += 1
        if count > 1 and random.random() >= share:
            return [message]
        return [replace(message, content=change(random, message))]

    rewrite_bag(base, folder / 'bag', changed)
    return folder / 'bag'


ALL = (
    topics.IMU,
    topics.ODOMETRY,
    topics.POINT_CLOUD,
    topics.CAMERA_INFO,
    topics.TRANSFORMS,
    topics.TEMPERATURE,
)
STAMPED = (topics.IMU, topics.ODOMETRY, topics.POINT_CLOUD)


def damage_cdr(random: Random, base: Path, folder: Path) -> Path:
    """Damage the bytes of messages: empty, cut, flipped, longer."""

    def change(random: Random, message: RawMessage) -> bytes:
        if random.random() < 0.1:
            return b''
        return damaged_bytes(random, message.content)

    return damaged_copy(random, base, folder, ALL, change)


def damage_numbers(random: Random, base: Path, folder: Path) -> Path:
    """Replace numbers of IMU, odometry and temperature by NaN, infinity and impossible values."""
    value = random.choice(STRANGE_NUMBERS)
    name = random.choice('xyz')

    def change(random: Random, message: RawMessage) -> bytes:
        content = decode(message)
        if message.type_name == topics.IMU:
            part = random.choice((content.angular_velocity, content.linear_acceleration))
            setattr(part, name, value)
        elif message.type_name == topics.ODOMETRY:
            part = random.choice((content.twist.twist.linear, content.twist.twist.angular))
            setattr(part, name, value)
        else:
            content.temperature = value
        return encode(content, message.type_name)

    return damaged_copy(random, base, folder, (topics.IMU, topics.ODOMETRY, topics.TEMPERATURE), change)


def damage_stamps(random: Random, base: Path, folder: Path) -> Path:
    """Set stamps to zero, to the limits of their type, back, ahead, and nanoseconds beyond a second."""
    strange = random.choice(((0, 0), (2**31 - 1, 0), (-(2**31), 0), (1, 2**32 - 1), None))
    step_s = random.choice((-3600, -10, -1, 1, 10, 3600, 10**8))

    def change(random: Random, message: RawMessage) -> bytes:
        content = bytearray(message.content)
        sec, nanosec = strange or (struct.unpack_from('<i', content, 4)[0] + step_s, 0)
        struct.pack_into('<iI', content, 4, max(-(2**31), min(sec, 2**31 - 1)), nanosec)
        return bytes(content)

    return damaged_copy(random, base, folder, STAMPED, change)


def changed_message(change: Callable[[Random, Any], None]) -> Callable[[Random, RawMessage], bytes]:
    """Return a change of contents from a change of the decoded message in place."""

    def changed(random: Random, message: RawMessage) -> bytes:
        content = decode(message)
        change(random, content)
        return encode(content, message.type_name)

    return changed
