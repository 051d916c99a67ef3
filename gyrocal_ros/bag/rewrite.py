"""Copies a recording of ROS 2 message by message, with changes to their serialised content."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from gyrocal_ros.bag.storage import open_storage, ros_types


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A serialised message (CDR)."""

    topic: str
    type_name: str
    recorded_ns: int
    content: bytes


def rewrite_bag(
    source: Path,
    target: Path,
    change: Callable[[RawMessage], Iterable[RawMessage]],
    storage: Literal['mcap', 'sqlite3'] = 'mcap',
) -> None:
    """Write a copy of a recording; the contents need not be valid messages.

    Args:
        source: a recording of ROS 2 whose types ROS 2 defines.
        target: folder to create.
        change: returns the messages to write in place of one.
        storage: format of the copy.

    Raises:
        RecordingError: the source cannot be read.
    """
    connections: dict[tuple[str, str], Connection] = {}
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    with open_storage(source) as bag, Writer(target, version=9, storage_plugin=plugin) as writer:
        types = {topic.name: topic.type_name for topic in bag.topics.values()}
        for name, recorded_ns, raw in bag.raw_messages(list(bag.topics.values())):
            for new in change(RawMessage(name, types[name], recorded_ns, bytes(raw))):
                key = new.topic, new.type_name
                if key not in connections:
                    connections[key] = writer.add_connection(*key, typestore=ros_types())
                writer.write(connections[key], new.recorded_ns, new.content)


def decode(message: RawMessage) -> Any:
    """Return the message that a content represents."""
    return ros_types().deserialize_cdr(message.content, message.type_name)


def encode(message: Any, type_name: str) -> bytes:
    """Return the content that represents a message."""
    return bytes(ros_types().serialize_cdr(message, type_name))
