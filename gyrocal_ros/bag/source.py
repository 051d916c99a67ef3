"""A bag as a source of measurements: decoded, in the order of their stamps, in body axes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from gyrocal_ros.bag.decode import Decode, MessageDecoder
from gyrocal_ros.bag.rig import Geometry, read_geometry
from gyrocal_ros.bag.selection import Selection, TopicChoice, parse_remap, remap_roles, select_topics
from gyrocal_ros.bag.storage import DAMAGED, Storage, damaged_message, open_storage
from gyrocal_ros.config.sections import Config, RecordingConfig
from gyrocal_ros.data import ClockStep, Measurement, Rig, Span, nanoseconds
from gyrocal_ros.msgs import topics
from gyrocal_ros.msgs.issues import BagIssue, Severity, one_a_kind, refuse_errors
from gyrocal_ros.msgs.reorder import Drop, Reorderer
from gyrocal_ros.msgs.topics import Role

DROPPED = {
    Drop.LATE: 'came too late to be sorted in',
    Drop.DUPLICATE: 'repeat a stamp',
    Drop.ODD: 'are stamped far from those around them',
}


class BagSource:
    """The measurements of one robot in a recording, ready for the filter."""

    def __init__(
        self,
        path: Path,
        config: Config,
        selection: Selection,
        geometry: Geometry,
        span: Span,
        *,
        with_covariates: bool,
    ) -> None:
        """Use `open_bag`."""
        self._path, self._recording = path, config.recording
        self._selection, self._geometry, self._span = selection, geometry, span
        self._with_covariates = with_covariates
        self._pass_findings: list[BagIssue] = []

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
        """First and last time, about; a step of the clock is not foreseen."""
        return self._span

    @property
    def warnings(self) -> list[BagIssue]:
        """What was worked around, one of a kind; what was dropped shows after `measurements`."""
        return one_a_kind([*self._selection.findings, *self._geometry.findings, *self._pass_findings])

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements in the order of their stamps; may be called again.

        Raises:
            RecordingError: the recording is damaged, an image has the wrong size, or more than a few
                messages of a topic mean nothing (NaN).
        """
        step_ns = nanoseconds(self._recording.clock_step_s)
        order = Reorderer[Sequence[Measurement]](nanoseconds(self._recording.reorder_window_s), step_ns)
        with open_storage(self._path) as storage:
            decoder = MessageDecoder(
                storage,
                self._selection,
                self._geometry,
                other_clock_ns=step_ns,
                with_covariates=self._with_covariates,
            )
            for samples in _sorted(storage, decoder, order):
                if isinstance(samples, ClockStep):
                    yield samples
                else:
                    yield from samples
        self._pass_findings = [*decoder.findings, *_left_out(decoder, order)]


def open_bag(
    path: Path,
    config: Config,
    *,
    remap: Mapping[str, str] | None = None,
    namespace: str | None = None,
    heading_reference: str | None = None,
    with_covariates: bool = False,
) -> BagSource:
    """Open a recording for calibration.

    Args:
        path: a rosbag2 folder, one of its files, or a ROS 1 `.bag`.
        config: the settings; their remaps and heading reference count where none are given here.
        remap: usual name of a topic (`imu/data_raw`) to its name in the recording.
        namespace: the robot, where the recording holds several.
        heading_reference: topic to take the heading from, in place of the ceiling camera.
        with_covariates: yield all other recorded numbers too.

    Raises:
        RecordingError: there is no such recording, it is damaged, or it lacks what is needed.
        ConfigError: a remap is wrong.
    """
    choice = make_choice(config.recording, remap, namespace, heading_reference)
    with open_storage(path) as storage:
        selection = select_topics(storage.topics, choice)
        refuse_errors(selection.findings, str(path))
        geometry = read_geometry(storage, selection, config.camera)
        start_ns = topics.stamp_ns(storage.first_message(selection.topics[Role.IMU]))
        span = Span(start_ns, start_ns + storage.end_ns - storage.start_ns)
    return BagSource(path, config, selection, geometry, span, with_covariates=with_covariates)


def make_choice(
    recording: RecordingConfig,
    remap: Mapping[str, str] | None,
    namespace: str | None,
    heading_reference: str | None,
) -> TopicChoice:
    """Join what the settings say about the topics with what the caller says, who comes first.

    Raises:
        ConfigError: a remap is wrong.
    """
    return TopicChoice(
        remap=remap_roles({**parse_remap(recording.remap.split()), **(remap or {})}),
        namespace=namespace,
        heading_reference=heading_reference or recording.heading_reference or None,
        use_images=recording.use_images,
    )


def _sorted(
    storage: Storage, decoder: MessageDecoder, order: Reorderer[Sequence[Measurement]]
) -> Iterator[Sequence[Measurement] | ClockStep]:
    """Yield what was measured at each moment, in the order of the stamps."""
    decoders: dict[str, list[tuple[int, Decode]]] = defaultdict(list)
    for stream, (topic, decode) in enumerate(decoder.streams):
        decoders[topic.name].append((stream, decode))
    used = {topic.name: topic for topic, _ in decoder.streams}
    for name, recorded_ns, raw in storage.raw_messages(used.values()):
        for stream, decode in decoders[name]:
            try:
                samples = decode(raw, recorded_ns)
            except DAMAGED as error:
                raise damaged_message(storage.path, name, error) from error
            if samples:
                t_ns = samples[0].t_ns
                decoder.stamps_ahead_ns = t_ns - recorded_ns
                yield from order.push(t_ns, stream, samples)
    yield from order.finish()


def _left_out(decoder: MessageDecoder, order: Reorderer[Sequence[Measurement]]) -> Iterator[BagIssue]:
    """Tell what was dropped, one finding a kind."""
    for drop, what in DROPPED.items():
        counts = {
            decoder.streams[stream][0].name: count
            for (kind, stream), count in order.drops.items()
            if kind is drop
        }
        if counts:
            yield _dropped(drop, counts, what)
    if decoder.bad:
        yield _dropped('meaningless', decoder.bad, 'hold no numbers (NaN) or no image')


def _dropped(kind: str, counts: Mapping[str, int], what: str) -> BagIssue:
    each = ', '.join(f'{count} of {topic}' for topic, count in sorted(counts.items()))
    return BagIssue(
        Severity.WARNING, kind, '', f'{sum(counts.values())} messages {what} and are left out: {each}'
    )
