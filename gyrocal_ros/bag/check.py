"""Looks through a recording before it is used: what is there, and what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrocal_ros.bag.assess import assess
from gyrocal_ros.bag.rig import read_links, read_rig
from gyrocal_ros.bag.scan import Seen, look_through
from gyrocal_ros.bag.selection import Selection, select_topics
from gyrocal_ros.bag.source import make_choice
from gyrocal_ros.bag.storage import Storage, open_storage
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import nanoseconds, seconds
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs import images, topics
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """One line of the table of topics; what was not looked at is NaN."""

    name: str
    type_name: str
    role: str
    """What it is used as: usual name of the topic, `covariate`, or nothing."""
    count: int
    rate_hz: float
    start_s: float
    """First and last stamp, since the first stamp of all."""
    end_s: float
    longest_gap_s: float


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What is in a recording, and what is wrong with it."""

    name: str
    duration_s: float
    topics: tuple[TopicSummary, ...]
    findings: tuple[BagIssue, ...]
    """The worst first."""

    @property
    def usable(self) -> bool:
        """Whether something can be calibrated from it."""
        return all(finding.severity is not Severity.ERROR for finding in self.findings)


def check_bag(
    path: Path,
    config: Config,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str | None = None,
    heading_reference: str | None = None,
) -> CheckReport:
    """Look through a recording once; the arguments are those of `open_bag`.

    Where the usual topics are missing, those that may be meant are looked at in their place.

    Raises:
        RecordingError: there is no such recording, or it is damaged.
        ConfigError: a remap is wrong.
    """
    recording = config.recording
    choice = make_choice(recording, remap, namespace, heading_reference)
    with open_storage(path) as storage:
        selection = select_topics(storage.topics, choice)
        findings = list(selection.findings)
        links = read_links(storage, selection)
        findings += _camera(storage, selection, links, config)
        seen = look_through(storage, selection, links, nanoseconds(recording.clock_step_s), findings)
        findings += assess(
            seen, reorder_window_s=recording.reorder_window_s, clock_step_s=recording.clock_step_s
        )
        return CheckReport(
            name=str(path),
            duration_s=seconds(storage.end_ns - storage.start_ns),
            topics=tuple(_summaries(storage, selection, seen)),
            findings=tuple(sorted(findings, key=lambda finding: list(Severity).index(finding.severity))),
        )


def _camera(
    storage: Storage, selection: Selection, links: Sequence[Transform], config: Config
) -> Iterator[BagIssue]:
    """Tell what is wrong with the camera: its calibration, its mount, the first of its images."""
    assumed: list[BagIssue] = []
    topic = selection.topics.get(Role.IMAGE)
    try:
        rig = read_rig(storage, selection, links, config.camera, assumed)
        if topic and rig.camera:
            images.refuse_other_size(images.frame(storage.first_message(topic)), rig.camera, topic.name)
    except RecordingError as error:
        yield BagIssue(Severity.ERROR, 'camera', topic.name if topic else '', error.what, error.todo)
    yield from assumed


def _summaries(storage: Storage, selection: Selection, seen: Seen) -> Iterator[TopicSummary]:
    duration_s = seconds(storage.end_ns - storage.start_ns)
    start_ns = min((watch.stamps.first_ns for watch in seen.watches), default=0)
    uses = {topic.name: 'covariate' for topic in selection.others.values()}
    uses |= {topic.name: topics.STATIC_TRANSFORMS for topic in selection.static_transforms}
    for role, topic in selection.topics.items():
        uses[topic.name] = f'{uses[topic.name]}, {role}' if topic.name in uses else str(role)
    stamps_of = {watch.topic.name: watch.stamps for watch in seen.watches}
    for topic in storage.topics.values():
        rate_hz = topic.count / duration_s if duration_s else math.nan
        start_s = end_s = longest_gap_s = math.nan
        if stamps := stamps_of.get(topic.name):
            rate_hz, longest_gap_s = stamps.rate_hz, abs(stamps.gap.worst_s)
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
