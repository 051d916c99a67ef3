"""A bag as a source of measurements: decoded, sorted by stamp, in body axes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from gyrocal_ros.bag.decode import Decode, MessageDecoder
from gyrocal_ros.bag.rig import Geometry, read_geometry
from gyrocal_ros.bag.selection import Selection, TopicOptions, parse_remap, remap_roles, select_topics
from gyrocal_ros.bag.storage import Storage, Topic, open_storage
from gyrocal_ros.config.sections import Config, RecordingConfig
from gyrocal_ros.data import NS_PER_S, ClockStep, ImuSample, Measurement, Rig, Span, nanoseconds
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.bursts import Bursts
from gyrocal_ros.msgs.issues import BagIssue, Severity, raise_first_error, worst_per_kind
from gyrocal_ros.msgs.reorder import Drop, Reorderer
from gyrocal_ros.msgs.topics import Role

MAX_PAUSE_NS = 120 * NS_PER_S
"""Longest pause of a recording that continues; a longer one is treated like a clock step."""
DROP_TEXTS = {
    Drop.LATE: 'are too late to be sorted in',
    Drop.DUPLICATE: 'repeat a stamp',
    Drop.OUTLIER: 'have stamps far from those before and after them',
}
"""Predicate that describes messages dropped for each reason."""


class Watch(Protocol):
    """Something that takes the messages of some topics in the first pass over a recording."""

    @property
    def used(self) -> Mapping[str, Topic]:
        """These topics, by name."""

    def add(self, name: str, recorded_ns: int, raw: bytes) -> None:
        """Take a message, with its time of recording."""

    def finish(self) -> None:
        """The pass has ended."""


class BagSource:
    """Yields the measurements of one robot in a recording, sorted and in body axes."""

    def __init__(
        self,
        path: Path,
        config: Config,
        selection: Selection,
        geometry: Geometry,
        span: Span,
        *,
        with_covariates: bool,
        watch: Watch | None = None,
    ) -> None:
        """Use `open_bag`."""
        self._path, self._recording = path, config.recording
        self._selection, self._geometry, self._span = selection, geometry, span
        self._with_covariates = with_covariates
        self._watch = watch
        self._pass_issues: list[BagIssue] = []

    @property
    def name(self) -> str:
        """Path of the recording."""
        return str(self._path)

    @property
    def rig(self) -> Rig:
        """The geometry of the robot."""
        return self._geometry.rig

    @property
    def span(self) -> Span:
        """Approximate first and last stamp; a step of the clock is not taken into account."""
        return self._span

    @property
    def warnings(self) -> list[BagIssue]:
        """Issues that were worked around, one per kind, with dropped messages once `measurements` has run."""
        return worst_per_kind([*self._selection.issues, *self._geometry.issues, *self._pass_issues])

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements in the order of their stamps; may be called again.

        Raises:
            RecordingError: the recording is damaged, an image has the wrong size, or too many messages
                of a needed topic are invalid (NaN).
        """
        step_ns, window_ns = (
            nanoseconds(time_s) for time_s in (self._recording.clock_step_s, self._recording.reorder_window_s)
        )
        with open_storage(self._path) as storage:
            decoder = MessageDecoder(
                storage,
                self._selection,
                self._geometry,
                other_clock_ns=step_ns,
                with_covariates=self._with_covariates,
            )
            reorderer = Reorderer[Sequence[Measurement]](window_ns, step_ns, followers=decoder.followers)
            watch, self._watch = self._watch, None
            for samples in _read_sorted(storage, decoder, reorderer, watch):
                if isinstance(samples, ClockStep):
                    yield samples
                else:
                    yield from samples
        self._pass_issues = [*decoder.issues, *_drop_issues(decoder, reorderer)]


def open_bag(
    path: Path,
    config: Config,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str | None = None,
    heading_reference: str | None = None,
    with_covariates: bool = False,
    watch: Watch | None = None,
) -> BagSource:
    """Open a recording for calibration.

    Args:
        path: a rosbag2 folder, one of its files, or a ROS 1 `.bag`.
        config: the settings; their remaps and heading reference apply if none are given here.
        remap: usual name of a topic (`imu/data_raw`) to its name in the recording.
        namespace: namespace of the robot, if the recording holds several.
        heading_reference: topic that provides the heading, in place of the ceiling camera.
        with_covariates: yield all other recorded numbers too.
        watch: takes the messages of the first pass as well.

    Raises:
        RecordingError: there is no such recording, it is damaged, or it lacks a needed topic.
        ConfigError: a remap is wrong.
    """
    options = topic_options(config.recording, remap, namespace, heading_reference)
    with open_storage(path) as storage:
        selection = select_topics(storage.topics, options)
        raise_first_error(selection.issues, str(path))
        geometry = read_geometry(storage, selection, config.camera)
        start_ns = topics.stamp_ns(storage.first_message(selection.topics[Role.IMU]))
        span = Span(start_ns, start_ns + storage.end_ns - storage.start_ns)
    return BagSource(path, config, selection, geometry, span, with_covariates=with_covariates, watch=watch)


def topic_options(
    recording: RecordingConfig,
    remap: Mapping[str, str] | None,
    namespace: str | None,
    heading_reference: str | None,
) -> TopicOptions:
    """Combine the topic settings with the arguments, which take precedence.

    Raises:
        ConfigError: a remap is wrong.
    """
    return TopicOptions(
        remap=remap_roles({**parse_remap(recording.remap.split()), **(remap or {})}),
        namespace=namespace,
        heading_reference=heading_reference or recording.heading_reference or None,
        use_images=recording.use_images,
    )


def _read_sorted(
    storage: Storage,
    decoder: MessageDecoder,
    reorderer: Reorderer[Sequence[Measurement]],
    watch: Watch | None,
) -> Iterator[Sequence[Measurement] | ClockStep]:
    """Yield the measurements of each message, in the order of the stamps."""
    decoders: dict[str, list[tuple[int, Decode]]] = defaultdict(list)
    for stream, (topic, decode) in enumerate(decoder.streams):
        decoders[topic.name].append((stream, decode))
    used = {topic.name: topic for topic, _ in decoder.streams}
    if watch is not None:
        used |= watch.used
    bursts = Bursts()
    arrival_ns = last_ns = storage.start_ns
    for name, recorded_ns, raw in storage.raw_messages(used.values()):
        if watch is not None:
            watch.add(name, recorded_ns, raw)
        if name not in decoders:
            continue
        arrival_ns += min(max(recorded_ns - last_ns, 0), MAX_PAUSE_NS)
        last_ns = recorded_ns
        for stream, decode in decoders[name]:
            samples = decode(raw, recorded_ns)
            if not samples:
                continue
            decoder.stamp_offset_ns = samples[0].t_ns - recorded_ns
            if not isinstance(samples[0], ImuSample):
                yield from reorderer.push(samples[0].t_ns, stream, samples, arrival_ns)
                continue
            for sample in bursts.add(samples[0]):
                yield from reorderer.push(sample.t_ns, stream, (sample,), arrival_ns)
    if watch is not None:
        watch.finish()
    yield from reorderer.finish()


def _drop_issues(decoder: MessageDecoder, reorderer: Reorderer[Sequence[Measurement]]) -> Iterator[BagIssue]:
    """Yield an issue for each reason for which messages were dropped."""
    for drop, predicate in DROP_TEXTS.items():
        counts = {
            decoder.streams[stream][0].name: count
            for (reason, stream), count in reorderer.drops.items()
            if reason is drop
        }
        if counts:
            yield _drop_issue(drop, counts, predicate)
    if decoder.others:
        predicate = 'are of another sensor, whose frame_id differs from that of the first message,'
        yield _drop_issue('other_sensor', decoder.others, predicate)
    if decoder.invalid:
        yield _drop_issue('meaningless', decoder.invalid, 'are invalid (NaN, or damaged)')


def _drop_issue(kind: str, counts: Mapping[str, int], predicate: str) -> BagIssue:
    each = ', '.join(f'{count} of {topic}' for topic, count in sorted(counts.items()))
    total = sum(counts.values())
    return BagIssue(Severity.WARNING, kind, '', f'{total} messages {predicate} and are left out: {each}')
