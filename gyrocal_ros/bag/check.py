"""Check of a recording before it is used: its topics and its issues."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from gyrocal_ros.bag.assess import assess
from gyrocal_ros.bag.feature_stats import FeatureStats
from gyrocal_ros.bag.rig import read_rig, read_static_transforms
from gyrocal_ros.bag.scan import BagScan, begin_scan
from gyrocal_ros.bag.selection import Selection, select_topics
from gyrocal_ros.bag.source import BagSource, open_bag, topic_options
from gyrocal_ros.bag.storage import Storage, Topic, open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Rig, nanoseconds, seconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.issues import BagIssue, Severity, raise_first_error
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform

RawMessages: TypeAlias = Iterable[tuple[str, int, bytes]]
"""Messages by topic, time of recording and bytes."""
Shown: TypeAlias = Callable[[RawMessages, int], RawMessages]
"""Function that passes messages on, of which there are so many, and shows how far they are."""


def not_shown(messages: RawMessages, count: int) -> RawMessages:
    """Pass messages on, and show nothing."""
    return messages


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One row of the table of topics; figures of topics that are not scanned are NaN."""

    name: str
    type_name: str
    role: str
    """Use of the topic: its usual name, `covariate`, or an empty string if it is not used."""
    count: int
    rate_hz: float
    start_s: float
    """First stamp, relative to the first stamp of all topics."""
    end_s: float
    """Last stamp, relative to the first stamp of all topics."""
    longest_gap_s: float


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Topics and issues of a recording."""

    name: str
    duration_s: float
    topics: tuple[TopicSummary, ...]
    issues: tuple[BagIssue, ...]
    """Issues, the most severe first."""

    @property
    def usable(self) -> bool:
        """True if the recording can be calibrated from."""
        return all(issue.severity is not Severity.ERROR for issue in self.issues)


@dataclass(slots=True)
class Checked:
    """A recording that is checked while it is read."""

    source: BagSource
    issues: tuple[BagIssue, ...] = ()
    """Issues, the most severe first, once the check has ended."""


class BagCheck:
    """Check of a recording by its messages, which some pass over it adds.

    Args:
        path: the recording; it and the other arguments are those of `open_bag`.
        config: the settings.
        remap: usual name of a topic to its name in the recording.
        namespace: namespace of the robot.
        heading_reference: topic that provides the heading.

    Raises:
        RecordingError: there is no such recording, or it is damaged.
        ConfigError: a remap is wrong.
    """

    def __init__(
        self,
        path: Path,
        config: Config,
        *,
        remap: Mapping[str, str] | None = None,
        namespace: str | None = None,
        heading_reference: str | None = None,
    ) -> None:
        self._path, self._recording = path, config.recording
        options = topic_options(config.recording, remap, namespace, heading_reference)
        self.is_complete = False
        """True if all messages were added."""
        with open_storage(path) as storage:
            self._selection = select_topics(storage.topics, options)
            self.issues = list(self._selection.issues)
            """Issues that were found so far, before the messages."""
            links = read_static_transforms(storage, self._selection)
            self._rig, issues = _read_camera(storage, self._selection, links, config)
            self.issues += issues
            step_ns = nanoseconds(config.recording.clock_step_s)
            self._scan = begin_scan(storage, self._selection, links, step_ns, self.issues)
            self._topics, self._duration_s = storage.topics, seconds(storage.end_ns - storage.start_ns)

    @property
    def used(self) -> dict[str, Topic]:
        """Topics whose messages are to be added, by name."""
        return self._scan.used

    def add(self, name: str, recorded_ns: int, raw: bytes) -> None:
        """Add a message, with its time of recording."""
        self._scan.add(name, recorded_ns, raw)

    def begin_features(self) -> tuple[Topic | None, FeatureStats | None]:
        """Return the topic of features, whose messages are to be decoded as well, and their statistics."""
        topic = self._selection.topics.get(Role.FEATURES)
        if topic and self._rig:
            self._scan.features = FeatureStats.of(self._rig)
        return topic, self._scan.features

    def finish(self) -> None:
        """All messages were added."""
        self._scan.finish()
        self.is_complete = True

    def report(self) -> CheckReport:
        """Return the topics and issues, when all messages were added."""
        issues = [*self.issues, *assess(self._scan, reorder_window_s=self._recording.reorder_window_s)]
        return CheckReport(
            name=str(self._path),
            duration_s=self._duration_s,
            topics=tuple(_summaries(self._topics, self._duration_s, self._selection, self._scan)),
            issues=tuple(sorted(issues, key=lambda issue: list(Severity).index(issue.severity))),
        )


def check_bag(path: Path, config: Config, shown: Shown = not_shown, **options: Any) -> CheckReport:
    """Check a recording in one pass, its features included; the other arguments are those of `BagCheck`.

    If the usual topics are missing, the topics that could replace them are checked instead.

    Args:
        path: the recording.
        config: the settings.
        shown: shows the progress over the messages, of which there are so many.
        options: see `BagCheck`.

    Raises:
        RecordingError: there is no such recording, or it is damaged.
        ConfigError: a remap is wrong.
    """
    check = BagCheck(path, config, **options)
    with open_storage(path) as storage:
        topic, features = check.begin_features()
        count = sum(used.count for used in check.used.values())
        for name, recorded_ns, raw in shown(storage.raw_messages(check.used.values()), count):
            check.add(name, recorded_ns, raw)
            if topic and features and name == topic.name:
                features.add(partial(storage.message, topic, raw))
    check.finish()
    return check.report()


@contextmanager
def checked_bag(path: Path, config: Config, *, with_covariates: bool, **options: Any) -> Iterator[Checked]:
    """Check a recording while it is read; the arguments are those of `open_bag`.

    Reading and checking share a pass. The check ends with the block, and its errors take precedence over
    those of the block, whose cause they may be.

    Raises:
        RecordingError: there is no such recording, it is damaged, or it cannot be calibrated from.
        ConfigError: a remap is wrong.
    """
    check = BagCheck(path, config, **options)
    raise_first_error(check.issues, str(path))
    source = open_bag(path, config, with_covariates=with_covariates, watch=check, **options)
    checked = Checked(source)
    try:
        yield checked
    except Exception:
        checked.issues = check_bag(path, config, **options).issues
        raise_first_error(checked.issues, str(path))
        raise
    report = check.report() if check.is_complete else check_bag(path, config, **options)
    raise_first_error(report.issues, str(path))
    checked.issues = report.issues


def _read_camera(
    storage: Storage, selection: Selection, links: Sequence[Transform], config: Config
) -> tuple[Rig | None, list[BagIssue]]:
    """Return the camera, with the issues of its calibration, its mount, and the size of its first image."""
    rig: Rig | None = None
    issues: list[BagIssue] = []
    topic = selection.topics.get(Role.IMAGE)
    try:
        rig = read_rig(storage, selection, links, config.camera, issues)
        if topic and rig.camera:
            from gyrocal_ros.msgs import images  # OpenCV is loaded only for images

            images.require_camera_size(images.frame(storage.first_message(topic)), rig.camera, topic.name)
    except RecordingError as error:
        wrong = BagIssue(Severity.ERROR, 'camera', topic.name if topic else '', error.what, error.todo)
        issues.insert(0, wrong)
    return rig, issues


def _summaries(
    recorded: Mapping[str, Topic], duration_s: float, selection: Selection, bag: BagScan
) -> Iterator[TopicSummary]:
    start_ns = min((scan.stamps.first_ns for scan in bag.topics), default=0)
    uses = {topic.name: 'covariate' for topic in selection.others.values()}
    uses |= {topic.name: topics.STATIC_TRANSFORMS for topic in selection.static_transforms}
    for role, topic in selection.topics.items():
        uses[topic.name] = f'{uses[topic.name]}, {role}' if topic.name in uses else str(role)
    stamps_of = {scan.topic.name: scan.stamps for scan in bag.topics}
    for topic in recorded.values():
        rate_hz = topic.count / duration_s if duration_s else math.nan
        start_s = end_s = longest_gap_s = math.nan
        if stamps := stamps_of.get(topic.name):
            rate_hz, longest_gap_s = stamps.rate_hz, abs(stamps.gap.largest_s)
            start_s, end_s = (seconds(t_ns - start_ns) for t_ns in (stamps.first_ns, stamps.last_ns))
        yield TopicSummary(
            topic.name,
            topic.type_name,
            uses.get(topic.name, ''),
            topic.count,
            rate_hz,
            start_s,
            end_s,
            longest_gap_s,
        )
