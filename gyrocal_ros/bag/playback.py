"""Playback of a recording to running nodes: messages as ROS 2 sends them, under the names nodes expect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto

from gyrocal_ros.bag.selection import Selection
from gyrocal_ros.bag.storage import Storage, Topic
from gyrocal_ros.msgs.topics import CAMERA_INFO, COMPRESSED_IMAGE, STATIC_TRANSFORMS, TRANSFORMS, Role

NOT_PLAYED = ('diagnostic_msgs/', 'rcl_interfaces/', 'rosgraph_msgs/')
"""Prefixes of message types that are not played: with them the recorded nodes reported their own state."""


class PublishMode(Enum):
    """Mode of publishing the messages of a topic."""

    STREAM = auto()
    """Messages are published one after the other."""
    IMAGE = auto()
    """Messages are published one after the other, with a short queue because they are large."""
    LATCHED = auto()
    """All messages are published at the start and delivered to late subscribers too."""


@dataclass(frozen=True, slots=True)
class PlayedTopic:
    """A topic under the name and in the mode in which it is played."""

    name: str
    """Relative name, so that the robot's namespace can precede it; absolute for transforms."""
    type_name: str
    mode: PublishMode = PublishMode.STREAM
    repeats: bool = False
    """True if the last message is repeated periodically, as cameras do with their calibration."""


class Playback:
    """The messages of one robot in a recording, in the order of recording.

    Args:
        storage: the open recording.
        selection: its topics.
    """

    def __init__(self, storage: Storage, selection: Selection) -> None:
        self._storage = storage
        self._topics: dict[str, tuple[PlayedTopic, Topic]] = {}
        for role, topic in selection.topics.items():
            self._topics[topic.name] = _played_topic(role, topic), topic
        for name, topic in selection.others.items():
            if storage.can_publish(topic) and not topic.type_name.startswith(NOT_PLAYED):
                self._topics[topic.name] = PlayedTopic(name, topic.type_name), topic
        self._static_transforms = selection.static_transforms

    @property
    def topics(self) -> list[PlayedTopic]:
        """Topics whose messages are played one after the other."""
        return [played for played, _ in self._topics.values()]

    def latched_messages(self) -> Iterator[tuple[PlayedTopic, bytes]]:
        """Yield topic and content (CDR) of the messages that are latched: the static transforms.

        Raises:
            RecordingError: the recording is damaged.
        """
        played = PlayedTopic(f'/{STATIC_TRANSFORMS}', TRANSFORMS, PublishMode.LATCHED)
        for topic in self._static_transforms:
            for _, _, raw in self._storage.raw_messages([topic]):
                yield played, self._storage.as_cdr(topic, raw)

    def messages(self) -> Iterator[tuple[int, PlayedTopic, bytes]]:
        """Yield time of recording (ns), topic and content (CDR) of the other messages.

        Raises:
            RecordingError: the recording is damaged.
        """
        recorded_topics = [topic for _, topic in self._topics.values()]
        for name, recorded_ns, raw in self._storage.raw_messages(recorded_topics):
            played, topic = self._topics[name]
            yield recorded_ns, played, self._storage.as_cdr(topic, raw)


def _played_topic(role: Role, topic: Topic) -> PlayedTopic:
    if role is Role.IMAGE:
        suffix = '/compressed' if topic.type_name == COMPRESSED_IMAGE else ''
        return PlayedTopic(f'{role}{suffix}', topic.type_name, PublishMode.IMAGE)
    return PlayedTopic(str(role), topic.type_name, repeats=topic.type_name == CAMERA_INFO)
