"""A recording as it is played to running nodes: messages as they are sent, under the names they want."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto

from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.msgs.topics import CAMERA_INFO, COMPRESSED_IMAGE, STATIC_TRANSFORMS, TRANSFORMS, Role

NOT_PLAYED = ('diagnostic_msgs/', 'rcl_interfaces/', 'rosgraph_msgs/')
"""Types of messages with which nodes tell about themselves: those of the recording run no more."""


class Kind(Enum):
    """How messages are sent."""

    FLOW = auto()
    """One after the other."""
    IMAGE = auto()
    """Likewise, few at a time, for they are large."""
    LATCHED = auto()
    """All of them to everybody who comes, from the start."""


@dataclass(frozen=True, slots=True)
class Track:
    """A topic as it is played."""

    name: str
    """Relative, so that a robot's namespace can stand before it; absolute for transforms."""
    type_name: str
    kind: Kind = Kind.FLOW
    repeats: bool = False
    """Whether the last message is sent again from time to time, as cameras do with their calibration."""


class Playback:
    """The messages of one robot in a recording, in the order in which they were recorded.

    Args:
        storage: the open recording.
        selection: its topics.
    """

    def __init__(self, storage: Storage, selection: Selection) -> None:
        self._storage = storage
        self._tracks: dict[str, tuple[Track, Topic]] = {}
        for role, topic in selection.topics.items():
            self._tracks[topic.name] = _track(role, topic), topic
        for name, topic in selection.others.items():
            if storage.can_send(topic) and not topic.type_name.startswith(NOT_PLAYED):
                self._tracks[topic.name] = Track(name, topic.type_name), topic
        self._static = selection.static_transforms

    @property
    def tracks(self) -> list[Track]:
        """What is played one after the other."""
        return [track for track, _ in self._tracks.values()]

    def latched(self) -> Iterator[tuple[Track, bytes]]:
        """Yield what has to be known from the start, as ROS 2 sends it (CDR).

        Raises:
            RecordingError: the recording is damaged.
        """
        track = Track(f'/{STATIC_TRANSFORMS}', TRANSFORMS, Kind.LATCHED)
        for topic in self._static:
            for _, _, raw in self._storage.raw_messages([topic]):
                yield track, self._storage.as_sent(topic, raw)

    def messages(self) -> Iterator[tuple[int, Track, bytes]]:
        """Yield time of recording (ns), track and message as ROS 2 sends it (CDR).

        Raises:
            RecordingError: the recording is damaged.
        """
        for name, recorded_ns, raw in self._storage.raw_messages(
            [topic for _, topic in self._tracks.values()]
        ):
            track, topic = self._tracks[name]
            yield recorded_ns, track, self._storage.as_sent(topic, raw)


def _track(role: Role, topic: Topic) -> Track:
    if role is Role.IMAGE:
        ending = '/compressed' if topic.type_name == COMPRESSED_IMAGE else ''
        return Track(f'{role}{ending}', topic.type_name, Kind.IMAGE)
    return Track(str(role), topic.type_name, repeats=topic.type_name == CAMERA_INFO)
