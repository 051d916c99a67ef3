"""Decodes the messages of the topics in use to measurements in body axes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import islice, repeat
from typing import TypeAlias

import numpy as np

from gyrocal_ros.bag.fields import FieldReader
from gyrocal_ros.bag.rig import Geometry
from gyrocal_ros.bag.selection import NEEDED_ROLES, Selection
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.data import NS_PER_S, CovariateSample, HeadingSample, Measurement
from gyrocal_ros.errors import MessageError, RecordingError
from gyrocal_ros.msgs import clouds, topics
from gyrocal_ros.msgs.headings import FrameHeading, heading_conversion
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.mounts import into_body_axes
from gyrocal_ros.msgs.plausible import MAX_NUMBER, plausible
from gyrocal_ros.msgs.topics import STAMP_FIELDS, FieldConversion, Role

FRAME_AT = 12
"""Place of the frame in a message with a header, its length first, in ROS 1 and in ROS 2."""
MAX_INVALID_SHARE, MAX_INVALID = 0.1, 10
"""Limits of the invalid messages of a needed topic: a recording that exceeds both is refused."""

Decode: TypeAlias = Callable[[bytes, int], Sequence[Measurement]]
"""Function from a serialised message and its time of recording (ns) to its measurements, of equal stamp."""


class MessageDecoder:
    """Decodes the messages of one pass over a recording to measurements, and counts invalid messages."""

    def __init__(
        self,
        storage: Storage,
        selection: Selection,
        geometry: Geometry,
        *,
        other_clock_ns: int,
        with_covariates: bool,
    ) -> None:
        """Prepare a decoder for every topic in use.

        Args:
            storage: the open recording.
            selection: its topics.
            geometry: mounting of the sensors.
            other_clock_ns: offset to the time of recording above which stamps are of another clock.
            with_covariates: decode all other recorded numbers too.

        Raises:
            RecordingError: the type of a needed topic is unknown.
        """
        self.issues: list[BagIssue] = []
        """Topics that had to be left out."""
        self.invalid: Counter[str] = Counter()
        """Number of messages of each topic that were left out as invalid (NaN, damaged)."""
        self.others: Counter[str] = Counter()
        """Number of messages of each topic that were left out as those of another sensor."""
        self.stamp_offset_ns = 0
        """Latest stamp minus its time of recording; set by the user of the decoder."""
        self._heading = selection.heading
        self.streams: list[tuple[Topic, Decode]] = []
        """Each topic in use with its decoder; a topic with two roles appears twice."""
        self._storage, self._geometry, self._other_clock_ns = storage, geometry, other_clock_ns
        self._needed = {topic.name for role, topic in selection.topics.items() if role in NEEDED_ROLES}
        for role in Role:
            if role in selection.topics and role is not Role.CAMERA_INFO:
                topic = selection.topics[role]
                self.streams.append((topic, self._checked(topic, self._role_decoder(role, topic))))
        for name, topic in selection.others.items() if with_covariates else ():
            try:
                self.streams.append((topic, self._checked(topic, self._covariate_decoder(topic, name))))
            except RecordingError as error:
                self.issues.append(
                    BagIssue(Severity.WARNING, 'unknown_type', topic.name, f'is left out: {error.what}')
                )

    @property
    def followers(self) -> list[int]:
        """Numbers of the streams that no calibration needs: their stamps are no sign of time."""
        return [number for number, (topic, _) in enumerate(self.streams) if topic.name not in self._needed]

    def _checked(self, topic: Topic, decode: Decode) -> Decode:
        """Return a decoder that leaves out and counts messages that cannot be used."""

        def checked(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            try:
                return decode(raw, recorded_ns)
            except MessageError as error:
                self._count_invalid(topic, error)
                return ()

        return checked

    def _role_decoder(self, role: Role, topic: Topic) -> Decode:
        if role is Role.FEATURES:
            return self._feature_decoder(topic)
        if role is Role.IMAGE:
            return self._image_decoder(topic)
        if role is Role.HEADING:
            return self._heading_decoder(topic)
        conversion = topics.field_conversion(role, topic.type_name)
        if role is Role.IMU and not np.array_equal(self._geometry.R_bi, np.eye(3)):
            rotate = into_body_axes(self._geometry.R_bi)
            conversion = FieldConversion(
                conversion.fields, lambda *values: rotate(topics.imu_sample(*values))
            )
        decode = self._field_decoder(topic, conversion, role)
        return self._of_one_sensor(topic, decode) if role is Role.IMU else decode

    def _of_one_sensor(self, topic: Topic, decode: Decode) -> Decode:
        """Return a decoder that leaves out messages with another frame than the first has.

        Two sensors on one topic have two scale factors.
        """
        frame = b''

        def decode_own(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            nonlocal frame
            if frame and raw[FRAME_AT : FRAME_AT + len(frame)] != frame:
                self.others[topic.name] += 1
                return ()
            samples = decode(raw, recorded_ns)
            if not frame:
                is_big_endian = self._storage.cdr and not raw[1]
                size = int.from_bytes(raw[FRAME_AT : FRAME_AT + 4], 'big' if is_big_endian else 'little')
                frame = raw[FRAME_AT : FRAME_AT + 4 + size]
            return samples

        return decode_own

    def _field_decoder(self, topic: Topic, conversion: FieldConversion[Measurement], role: Role) -> Decode:
        read, build = self._storage.reader_of(topic, conversion.fields), conversion.build
        bounds = (*repeat(math.inf, len(STAMP_FIELDS)), *islice(topics.bounds(role), len(conversion.fields)))

        def decode(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            values = read(raw)
            if role is Role.IMU and math.isnan(values[-1]):
                values = (*values[:-3], *topics.measured_force(values[-3:]))
            if not plausible(values, bounds):
                what = 'the numbers are not finite (NaN), or impossibly large'
                raise MessageError(what, todo='check the driver of this sensor and its unit')
            return (build(*values),)

        return decode

    def _heading_decoder(self, topic: Topic) -> Decode:
        assert self._heading is not None
        if self._heading.frames is None:
            conversion = heading_conversion(topic.type_name, self._heading)
            return self._set_headings(
                topic,
                self._field_decoder(
                    topic, FieldConversion(conversion.fields, conversion.build), Role.HEADING
                ),
            )
        frames = FrameHeading(*self._heading.frames)

        def decode(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            sample = frames.add(self._storage.message(topic, raw))
            return (sample,) if sample else ()

        return decode

    def _set_headings(self, topic: Topic, decode: Decode) -> Decode:
        """Return a decoder that leaves out orientations that are not set."""

        def decode_set(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            samples = decode(raw, recorded_ns)
            if any(isinstance(item, HeadingSample) and math.isnan(item.yaw_rad) for item in samples):
                raise MessageError('the orientation is not set (all zero)', todo='use another reference')
            return samples

        return decode_set

    def _feature_decoder(self, topic: Topic) -> Decode:
        def decode(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            return (clouds.features(self._storage.message(topic, raw)),)

        return decode

    def _image_decoder(self, topic: Topic) -> Decode:
        from gyrocal_ros.msgs import images  # OpenCV is loaded only for images

        camera = self._geometry.rig.camera
        assert camera, 'images are not selected without camera_info'

        def decode(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            frame = images.frame(self._storage.message(topic, raw))
            images.require_camera_size(frame, camera, f'{self._storage.path}, {topic.name}')
            return (frame,)

        return decode

    def _covariate_decoder(self, topic: Topic, name: str) -> Decode:
        """Return a decoder of all scalar numbers of a topic, whose names are read from its first message."""
        stamp = STAMP_FIELDS if self._storage.has_header(topic) else ()
        names: list[str] = []
        read: FieldReader | None = None

        def decode(raw: bytes, recorded_ns: int) -> Sequence[Measurement]:
            nonlocal read
            if read is None:
                fields = list(topics.numeric_fields(self._storage.message(topic, raw)))
                names.extend(topics.covariate_name(name, field) for field in fields)
                read = self._storage.reader_of(topic, (*stamp, *fields)) if fields else lambda _: ()
            values = read(raw)
            if stamp and values:
                t_ns, values = values[0] * NS_PER_S + values[1], values[2:]
            else:
                t_ns = recorded_ns + self._clock_offset_ns()
            return [
                CovariateSample(t_ns, full_name, float(value))
                for full_name, value in zip(names, values, strict=True)
                if abs(value) < MAX_NUMBER
            ]

        return decode

    def _clock_offset_ns(self) -> int:
        """Return the offset from the time of recording to the stamps, 0 unless they use different clocks."""
        return self.stamp_offset_ns if abs(self.stamp_offset_ns) > self._other_clock_ns else 0

    def _count_invalid(self, topic: Topic, error: MessageError) -> None:
        """Count an invalid message; raise an error if a needed topic has too many of them."""
        self.invalid[topic.name] += 1
        count = self.invalid[topic.name]
        if topic.name in self._needed and count > max(MAX_INVALID, MAX_INVALID_SHARE * topic.count):
            place = f'{self._storage.path}, {topic.name}'
            raise RecordingError(f'{error.what} in at least {count} messages', where=place, todo=error.todo)
