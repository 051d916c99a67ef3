"""One quick pass over a recording that gathers the figures a check judges by."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from gyrocal_ros.bag.fields import FieldReader
from gyrocal_ros.bag.rig import read_imu_rotation
from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import DAMAGED, Storage, Topic, damaged_message
from gyrocal_ros.bag.topic_stats import ImuStats, StampStats, TurnStats
from gyrocal_ros.data import NS_PER_S, Array, IntArray
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.msgs.topics import (
    IMU_SAMPLE,
    STAMP_FIELDS,
    TYPES,
    WHEEL_SAMPLE,
    Role,
    heading_sample,
)
from gyrocal_ros.msgs.transforms import Transform, yaw_from_quaternion

BLOCK = 2048
"""Messages of a topic looked at together."""

Inspection: TypeAlias = Callable[[IntArray, Array], None]
"""Takes the stamps (n,) of a block of messages and their numbers (n, fields)."""


@dataclass(slots=True, eq=False)
class Watch:
    """One topic that is looked at."""

    topic: Topic
    role: Role
    read: FieldReader
    look: Inspection
    stamps: StampStats
    not_finite: int = 0
    """Messages with a number that is NaN or infinite."""
    _rows: list[tuple[float, ...]] = field(default_factory=list)
    _recorded_ns: list[int] = field(default_factory=list)

    def add(self, recorded_ns: int, raw: bytes) -> None:
        """Take one message."""
        self._rows.append(self.read(raw))
        self._recorded_ns.append(recorded_ns)
        if len(self._rows) == BLOCK:
            self.finish()

    def finish(self) -> None:
        """Look at the messages taken since the last time."""
        if not self._rows:
            return
        rows, recorded_ns = np.array(self._rows, float), np.array(self._recorded_ns, np.int64)
        self._rows, self._recorded_ns = [], []
        stamps_ns = rows[:, 0].astype(np.int64) * NS_PER_S + rows[:, 1].astype(np.int64)
        self.stamps.add(stamps_ns, recorded_ns)
        finite = np.isfinite(rows).all(axis=1)
        self.not_finite += int(np.count_nonzero(~finite))
        if finite.any():
            self.look(stamps_ns[finite], rows[finite, 2:])


@dataclass(slots=True)
class Seen:
    """What one pass has gathered."""

    watches: list[Watch] = field(default_factory=list)
    imus: dict[str, ImuStats] = field(default_factory=dict)
    """By topic; several where it is not known which is meant."""
    turns: dict[Role, TurnStats] = field(default_factory=dict)
    """By wheels and heading reference."""
    feature_count: int = 0
    """Features in all images together."""

    def of(self, role: Role) -> Watch | None:
        """Return the topic of a role, if there is one."""
        return next((watch for watch in self.watches if watch.role is role), None)


def look_through(
    storage: Storage,
    selection: Selection,
    links: Sequence[Transform],
    step_ns: int,
    findings: list[BagIssue],
) -> Seen:
    """Look at every message of the topics in use.

    Where there is no IMU or no wheel odometry by name, all topics of that type are looked at.

    Args:
        storage: the open recording.
        selection: its topics.
        links: its static transforms.
        step_ns: stamps have jumped when they leave the time of recording by more than this.
        findings: what is found about the mounting of the IMU is added to them.

    Raises:
        RecordingError: the recording is damaged.
    """
    seen = Seen()
    heading = selection.topics.get(Role.HEADING)
    for role, topic in _candidates(storage, selection):
        fields: tuple[str, ...] = STAMP_FIELDS
        look: Inspection = _nothing
        if role is Role.IMU:
            R_bi = read_imu_rotation(storage, topic, links, heading, findings)
            stats = seen.imus[topic.name] = ImuStats(R_bi)
            fields, look = IMU_SAMPLE.fields, stats.add
        elif role is Role.WHEELS:
            fields, look = WHEEL_SAMPLE.fields, _look_at_wheels(seen)
        elif role is Role.HEADING:
            fields, look = heading_sample(topic.type_name).fields, _look_at_heading(seen)
        elif role is Role.FEATURES:
            fields, look = (*STAMP_FIELDS, 'width'), _look_at_features(seen)
        seen.watches.append(Watch(topic, role, storage.reader_of(topic, fields), look, StampStats(step_ns)))
    _pass(storage, seen.watches)
    return seen


def _candidates(storage: Storage, selection: Selection) -> Iterator[tuple[Role, Topic]]:
    for role in Role:
        if role in selection.topics and role is not Role.CAMERA_INFO:
            yield role, selection.topics[role]
        elif role in (Role.IMU, Role.WHEELS):
            fitting = [
                topic for topic in storage.topics.values() if topic.type_name in TYPES[role] and topic.count
            ]
            free = [topic for topic in fitting if topic not in selection.topics.values()]
            if role is Role.IMU or len(free) == 1:
                yield from ((role, topic) for topic in free)


def _pass(storage: Storage, watches: Sequence[Watch]) -> None:
    by_topic: dict[str, list[Watch]] = defaultdict(list)
    for watch in watches:
        by_topic[watch.topic.name].append(watch)
    used = {watch.topic.name: watch.topic for watch in watches}
    for name, recorded_ns, raw in storage.raw_messages(used.values()):
        for watch in by_topic[name]:
            try:
                watch.add(recorded_ns, raw)
            except DAMAGED as error:
                raise damaged_message(storage.path, name, error) from error
    for watch in watches:
        watch.finish()


def _nothing(stamps_ns: IntArray, numbers: Array) -> None:
    """Look at the stamps alone."""


def _look_at_wheels(seen: Seen) -> Inspection:
    turns = seen.turns[Role.WHEELS] = TurnStats()
    return lambda stamps_ns, numbers: turns.add(stamps_ns, numbers[:, 1])


def _look_at_heading(seen: Seen) -> Inspection:
    turns = seen.turns[Role.HEADING] = TurnStats()

    def look(stamps_ns: IntArray, quaternions: Array) -> None:
        turns.add_headings(stamps_ns, np.array([yaw_from_quaternion(*row) for row in quaternions.tolist()]))

    return look


def _look_at_features(seen: Seen) -> Inspection:
    def look(stamps_ns: IntArray, widths: Array) -> None:
        seen.feature_count += int(widths.sum())

    return look
