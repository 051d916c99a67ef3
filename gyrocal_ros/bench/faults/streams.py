"""Damage to whole topics, where each message on its own is valid: frames, clocks, repetitions, gaps."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

from gyrocal_ros.bag.rewrite import RawMessage, decode, encode, rewrite_bag
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.msgs import topics

STAMP_NS_FORMAT, STAMP_PLACE = '<iI', 4
STREAMS = (topics.IMU, topics.ODOMETRY, topics.POINT_CLOUD)
"""Types of the topics that are damaged: IMU, wheels or ground truth, features."""

Change: TypeAlias = Callable[[RawMessage, float], Iterable[RawMessage]]
"""Function from a message and its time (s since the start) to those in place of it."""


def damage_streams(random: Random, base: Path, folder: Path) -> Path:
    """Damage one or all topics of a bag in one of the ways of `DAMAGES`."""
    change = random.choice(DAMAGES)(random)
    start_ns: int | None = None

    def changed(message: RawMessage) -> Iterable[RawMessage]:
        nonlocal start_ns
        start_ns = message.recorded_ns if start_ns is None else start_ns
        return change(message, (message.recorded_ns - start_ns) / NS_PER_S)

    rewrite_bag(base, folder / 'bag', changed)
    return folder / 'bag'


# --- stamps -------------------------------------------------------------------------------------


def _restamped(message: RawMessage, shift_ns: int) -> RawMessage:
    content = bytearray(message.content)
    sec, nanosec = struct.unpack_from(STAMP_NS_FORMAT, content, STAMP_PLACE)
    sec, nanosec = divmod(sec * NS_PER_S + nanosec + shift_ns, NS_PER_S)
    struct.pack_into(STAMP_NS_FORMAT, content, STAMP_PLACE, max(-(2**31), min(sec, 2**31 - 1)), nanosec)
    return replace(message, content=bytes(content))


def _stamp_ns(message: RawMessage) -> int:
    sec, nanosec = struct.unpack_from(STAMP_NS_FORMAT, message.content, STAMP_PLACE)
    return int(sec * NS_PER_S + nanosec)


def _other_clock(random: Random) -> Change:
    """Shift the stamps of a topic, for a time or throughout."""
    kind, shift_s = random.choice(STREAMS), random.choice((-1e9, -3.0, -0.3, 0.3, 1.5, 3.0, 3600.0))
    begin_s, end_s = random.choice(((0.0, 1e9), (10.0, 15.0)))

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        is_shifted = message.type_name == kind and begin_s <= time_s < end_s
        return [_restamped(message, round(shift_s * NS_PER_S)) if is_shifted else message]

    return change


def _coarse_stamps(random: Random) -> Change:
    """Round the stamps of a topic down."""
    kind, step_ns = random.choice(STREAMS), random.choice((10**7, 10**8, 10**9))

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        is_changed = message.type_name == kind
        return [_restamped(message, -(_stamp_ns(message) % step_ns)) if is_changed else message]

    return change


def _reversed_blocks(random: Random) -> Change:
    """Reverse the stamps of a topic in blocks."""
    kind, length_s = random.choice(STREAMS), random.choice((0.1, 1.0, 5.0))

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        shift_s = length_s - 2.0 * (time_s % length_s)
        return [_restamped(message, round(shift_s * NS_PER_S)) if message.type_name == kind else message]

    return change


# --- repetitions and gaps -----------------------------------------------------------------------


def _sent_again(random: Random) -> Change:
    """Repeat every message of a topic: at once or later, with the old stamp or a new one."""
    kind, delay_s = random.choice(STREAMS), random.choice((0.0, 0.002, 0.04, 1.0))
    shift_ns = random.choice((0, round(delay_s * NS_PER_S)))

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        if message.type_name != kind:
            return [message]
        recorded_ns = message.recorded_ns + round(delay_s * NS_PER_S)
        return [message, replace(_restamped(message, shift_ns), recorded_ns=recorded_ns)]

    return change


def _gap(random: Random) -> Change:
    """Leave out a stretch of one topic or of all."""
    lost = random.choice(((topics.IMU,), (topics.IMU, topics.ODOMETRY), (topics.POINT_CLOUD,), STREAMS))
    begin_s, length_s = random.choice((0.0, 5.0, 12.0)), random.choice((1.0, 5.0, 10.0, 1e9))

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        is_lost = message.type_name in lost and begin_s <= time_s < begin_s + length_s
        return [] if is_lost else [message]

    return change


# --- frames and geometry ------------------------------------------------------------------------


def _edited(kind: str, edit: Callable[[Any], None]) -> Change:
    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        if message.type_name != kind:
            return [message]
        content = decode(message)
        edit(content)
        return [replace(message, content=encode(content, kind))]

    return change


def _other_frame(random: Random) -> Change:
    """Replace the frame of a topic."""
    frame = random.choice(('', 'base_link', 'wrong_link', '/imu_link', 'map', 'ä' * 200))
    return _edited(
        random.choice((*STREAMS, topics.CAMERA_INFO)), lambda m: setattr(m.header, 'frame_id', frame)
    )


def _exchanged_frames(random: Random) -> Change:
    """Rename or exchange the frames of the static transforms."""
    rename = random.random() < 0.5

    def edit(message: Any) -> None:
        links = message.transforms
        if rename:
            random.choice(links).child_frame_id = 'renamed'
        else:
            links[0].child_frame_id, links[-1].child_frame_id = (
                links[-1].child_frame_id,
                links[0].child_frame_id,
            )

    return _edited(topics.TRANSFORMS, edit)


def _other_camera_info(random: Random) -> Change:
    """Repeat camera_info later, from then on with another focal length, or with none at first."""
    factor, is_first = random.choice((0.0, 0.5, 1.1, 2.0)), random.random() < 0.5

    def change(message: RawMessage, time_s: float) -> Iterable[RawMessage]:
        if message.type_name != topics.CAMERA_INFO:
            return [message]
        info = decode(message)
        info.k = info.k * (factor, 1.0, 1.0, 1.0, factor, 1.0, 1.0, 1.0, 1.0)
        other = replace(message, content=encode(info, message.type_name))
        if is_first and not factor:
            return [other, message]
        return [message, replace(other, recorded_ns=message.recorded_ns + 10 * NS_PER_S)]

    return change


DAMAGES: tuple[Callable[[Random], Change], ...] = (
    _other_clock,
    _coarse_stamps,
    _reversed_blocks,
    _sent_again,
    _gap,
    _other_frame,
    _exchanged_frames,
    _other_camera_info,
)
"""Kinds of damage: functions from random numbers to a change."""
