"""Check of a recording before it is used: its topics and its issues."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrocal_ros.bag.assess import assess
from gyrocal_ros.bag.rig import read_rig, read_static_transforms
from gyrocal_ros.bag.scan import BagScan, scan_bag
from gyrocal_ros.bag.selection import Selection, select_topics
from gyrocal_ros.bag.source import topic_options
from gyrocal_ros.bag.storage import Storage, open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import nanoseconds, seconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform


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


def check_bag(
    path: Path,
    config: Config,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str | None = None,
    heading_reference: str | None = None,
) -> CheckReport:
    """Check a recording in one pass; the arguments are those of `open_bag`.

    If the usual topics are missing, the topics that could replace them are checked instead.

    Raises:
        RecordingError: there is no such recording, or it is damaged.
        ConfigError: a remap is wrong.
    """
    recording = config.recording
    options = topic_options(recording, remap, namespace, heading_reference)
    with open_storage(path) as storage:
        selection = select_topics(storage.topics, options)
        issues = list(selection.issues)
        links = read_static_transforms(storage, selection)
        issues += _camera_issues(storage, selection, links, config)
        scan = scan_bag(storage, selection, links, nanoseconds(recording.clock_step_s), issues)
        issues += assess(scan, reorder_window_s=recording.reorder_window_s)
        return CheckReport(
            name=str(path),
            duration_s=seconds(storage.end_ns - storage.start_ns),
            topics=tuple(_summaries(storage, selection, scan)),
            issues=tuple(sorted(issues, key=lambda issue: list(Severity).index(issue.severity))),
        )


def _camera_issues(
    storage: Storage, selection: Selection, links: Sequence[Transform], config: Config
) -> Iterator[BagIssue]:
    """Yield the issues of the camera: its calibration, its mount, and the size of its first image."""
    assumed: list[BagIssue] = []
    topic = selection.topics.get(Role.IMAGE)
    try:
        rig = read_rig(storage, selection, links, config.camera, assumed)
        if topic and rig.camera:
            from gyrocal_ros.msgs import images  # OpenCV is loaded only for images

            images.require_camera_size(images.frame(storage.first_message(topic)), rig.camera, topic.name)
    except RecordingError as error:
        yield BagIssue(Severity.ERROR, 'camera', topic.name if topic else '', error.what, error.todo)
    yield from assumed


def _summaries(storage: Storage, selection: Selection, bag: BagScan) -> Iterator[TopicSummary]:
    duration_s = seconds(storage.end_ns - storage.start_ns)
    start_ns = min((scan.stamps.first_ns for scan in bag.topics), default=0)
    uses = {topic.name: 'covariate' for topic in selection.others.values()}
    uses |= {topic.name: topics.STATIC_TRANSFORMS for topic in selection.static_transforms}
    for role, topic in selection.topics.items():
        uses[topic.name] = f'{uses[topic.name]}, {role}' if topic.name in uses else str(role)
    stamps_of = {scan.topic.name: scan.stamps for scan in bag.topics}
    for topic in storage.topics.values():
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
