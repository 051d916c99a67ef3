"""Scan of a recording: collects the statistics from which a check derives its issues, message by message."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import TypeAlias

import numpy as np

from gyrocal_ros.bag.feature_stats import FeatureStats
from gyrocal_ros.bag.fields import FieldReader
from gyrocal_ros.bag.rig import read_imu_rotation
from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.bag.topic_stats import ImuStats, StampStats, TurnStats
from gyrocal_ros.data import NS_PER_S, Array, HeadingSample, IntArray, WheelSample
from gyrocal_ros.errors import MessageError
from gyrocal_ros.model.faulty_readings import FaultyWheels
from gyrocal_ros.msgs.headings import heading_conversion
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.msgs.topics import (
    IMU_SAMPLE,
    STAMP_FIELDS,
    TYPES,
    WHEEL_SAMPLE,
    FieldConversion,
    Role,
    bounds,
)
from gyrocal_ros.msgs.transforms import Transform

BLOCK_SIZE = 2048
"""Number of messages of a topic that are processed together."""

BlockHandler: TypeAlias = Callable[[IntArray, Array], None]
"""Function that takes the stamps (n,) of a block of messages and their numbers (n, fields)."""


@dataclass(slots=True, eq=False)
class TopicScan:
    """Scan of one topic."""

    topic: Topic
    role: Role
    read: FieldReader
    handle: BlockHandler
    stamps: StampStats
    invalid: int = 0
    """Number of messages that are damaged, or have a number that is not finite or impossibly large."""
    _rows: list[tuple[float, ...]] = field(default_factory=list)
    _recorded_ns: list[int] = field(default_factory=list)

    def add(self, recorded_ns: int, raw: bytes) -> None:
        """Add one message; a damaged one is counted only."""
        try:
            self._rows.append(self.read(raw))
        except MessageError:
            self.invalid += 1
            return
        self._recorded_ns.append(recorded_ns)
        if len(self._rows) == BLOCK_SIZE:
            self.finish()

    def finish(self) -> None:
        """Process the messages added since the last block."""
        if not self._rows:
            return
        rows, recorded_ns = np.array(self._rows, float), np.array(self._recorded_ns, np.int64)
        self._rows, self._recorded_ns = [], []
        stamps_ns = rows[:, 0].astype(np.int64) * NS_PER_S + rows[:, 1].astype(np.int64)
        self.stamps.add(stamps_ns, recorded_ns)
        numbers = rows[:, len(STAMP_FIELDS) :]
        if self.role is Role.IMU:
            numbers[np.isnan(numbers[:, 3:]).all(axis=1), 3:] = 0.0  # as `topics.measured_force`
        valid = (np.abs(numbers) < list(islice(bounds(self.role), numbers.shape[1]))).all(axis=1)
        self.invalid += int(np.count_nonzero(~valid))
        if valid.any():
            self.handle(stamps_ns[valid], numbers[valid])


@dataclass(slots=True)
class BagScan:
    """Statistics of a recording; give it all messages of the topics in use, in one pass."""

    topics: list[TopicScan] = field(default_factory=list)
    imus: dict[str, ImuStats] = field(default_factory=dict)
    """Statistics by topic; several if no topic is selected as the IMU."""
    turns: dict[Role, TurnStats] = field(default_factory=dict)
    """Turns by wheels and by heading reference."""
    wheels: FaultyWheels = field(default_factory=FaultyWheels)
    """Readings of the encoders that the filter replaces."""
    wheels_move: bool = False
    """True if any reading of the encoders is not zero."""
    wheels_turn: bool = False
    """True if any turn by the encoders is not zero."""
    feature_count: int = 0
    """Number of features in all images together."""
    features: FeatureStats | None = None
    """Statistics of the features themselves; None where the point clouds were not decoded."""
    temperatures_c: tuple[float, float] = (math.inf, -math.inf)
    """Lowest and highest temperature."""
    _by_topic: dict[str, list[TopicScan]] = field(default_factory=lambda: defaultdict(list))

    @property
    def used(self) -> dict[str, Topic]:
        """Topics whose messages are scanned, by name."""
        return {scan.topic.name: scan.topic for scan in self.topics}

    def add(self, name: str, recorded_ns: int, raw: bytes) -> None:
        """Add a message of a topic, with its time of recording."""
        for scan in self._by_topic.get(name, ()):
            scan.add(recorded_ns, raw)

    def finish(self) -> None:
        """Process the last messages."""
        for scan in self.topics:
            scan.finish()

    def add_topic(self, scan: TopicScan) -> None:
        """Add a topic to scan."""
        self.topics.append(scan)
        self._by_topic[scan.topic.name].append(scan)

    def of_role(self, role: Role) -> TopicScan | None:
        """Return the scan of the topic of a role, if there is one."""
        return next((topic for topic in self.topics if topic.role is role), None)


def begin_scan(
    storage: Storage,
    selection: Selection,
    links: Sequence[Transform],
    step_ns: int,
    issues: list[BagIssue],
) -> BagScan:
    """Prepare the scan of every message of the topics in use.

    If no topic is selected as IMU, all topics of that type are scanned; if none is selected as wheel
    odometry, the only unused topic of that type is.

    Args:
        storage: the open recording.
        selection: its topics.
        links: its static transforms.
        step_ns: threshold of a jump of the stamps relative to the time of recording.
        issues: list to which issues of the mounting of the IMU are appended.

    Raises:
        RecordingError: the recording is damaged, or the type of a topic is unknown.
    """
    scan = BagScan()
    for role, topic in _topics_to_scan(storage, selection):
        fields: tuple[str, ...] = STAMP_FIELDS
        handle: BlockHandler = _ignore
        if role is Role.IMU:
            R_bi = read_imu_rotation(storage, topic, links, selection, issues)
            stats = scan.imus[topic.name] = ImuStats(R_bi)
            fields, handle = IMU_SAMPLE.fields, stats.add
        elif role is Role.WHEELS:
            fields, handle = WHEEL_SAMPLE.fields, _wheel_handler(scan)
        elif role is Role.HEADING:
            if selection.heading is None or selection.heading.frames:
                continue  # transforms have no stamp of their own
            conversion = heading_conversion(topic.type_name, selection.heading)
            fields, handle = conversion.fields, _heading_handler(scan, conversion)
        elif role is Role.TEMPERATURE:
            fields, handle = (*STAMP_FIELDS, 'temperature'), _temperature_handler(scan)
        elif role is Role.FEATURES:
            fields, handle = (*STAMP_FIELDS, 'width'), _feature_handler(scan)
        reader, stamps = storage.reader_of(topic, fields), StampStats(step_ns)
        scan.add_topic(TopicScan(topic, role, reader, handle, stamps))
    return scan


def _topics_to_scan(storage: Storage, selection: Selection) -> Iterator[tuple[Role, Topic]]:
    for role in Role:
        if role in selection.topics and role is not Role.CAMERA_INFO:
            yield role, selection.topics[role]
        elif role in (Role.IMU, Role.WHEELS):
            fitting = [
                topic for topic in storage.topics.values() if topic.type_name in TYPES[role] and topic.count
            ]
            unused = [topic for topic in fitting if topic not in selection.topics.values()]
            if role is Role.IMU or len(unused) == 1:
                yield from ((role, topic) for topic in unused)


def _ignore(stamps_ns: IntArray, numbers: Array) -> None:
    """Ignore the numbers, for topics of which only the stamps are checked."""


def _wheel_handler(scan: BagScan) -> BlockHandler:
    turns = scan.turns[Role.WHEELS] = TurnStats()

    def handle(stamps_ns: IntArray, numbers: Array) -> None:
        turns.add(stamps_ns, numbers[:, 1])
        scan.wheels_move |= bool(numbers.any())
        scan.wheels_turn |= bool(numbers[:, 1].any())
        readings = zip(stamps_ns.tolist(), numbers.tolist(), strict=True)
        scan.wheels.sound([WheelSample(t_ns, *motion) for t_ns, motion in readings])

    return handle


def _heading_handler(scan: BagScan, conversion: FieldConversion[HeadingSample]) -> BlockHandler:
    turns = scan.turns[Role.HEADING] = TurnStats()

    def handle(stamps_ns: IntArray, numbers: Array) -> None:
        yaws_rad = np.array([conversion.build(0, 0, *row).yaw_rad for row in numbers.tolist()])
        is_set = np.isfinite(yaws_rad)
        if is_set.any():
            turns.add_headings(stamps_ns[is_set], yaws_rad[is_set])

    return handle


def _temperature_handler(scan: BagScan) -> BlockHandler:
    def handle(stamps_ns: IntArray, numbers: Array) -> None:
        lowest, highest = scan.temperatures_c
        scan.temperatures_c = min(lowest, float(numbers.min())), max(highest, float(numbers.max()))

    return handle


def _feature_handler(scan: BagScan) -> BlockHandler:
    def handle(stamps_ns: IntArray, widths: Array) -> None:
        scan.feature_count += int(widths.sum())

    return handle
