"""Opens a recording of any kind: rosbag2 (sqlite3, mcap, compressed or not) and ROS 1 `.bag`.

All access to the files goes through this module, which converts every failure of a damaged file to a
`RecordingError` of one line.
"""

from __future__ import annotations

import errno
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from rosbags import rosbag1, rosbag2
from rosbags.convert.converter import migrate_message
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from gyrocal_ros.bag.bounds import require_bounded
from gyrocal_ros.bag.fields import FieldReader, field_reader
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.errors import GyrocalError, MessageError, RecordingError

STORAGE_FILES = ('.mcap', '.db3')
MAX_DURATION_NS = 366 * 86400 * NS_PER_S
"""Longest duration of a recording; a longer one has damaged times."""
IDL_SEPARATOR = '=' * 80 + '\n'
"""Separator of the types in a definition in IDL."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording."""

    name: str
    type_name: str
    """Name of the type in ROS 2 notation, for ROS 1 too: `sensor_msgs/msg/Imu`."""
    count: int
    """Number of messages."""
    connections: tuple[Connection, ...]


class Storage:
    """An open recording."""

    def __init__(self, path: Path, reader: rosbag1.Reader | rosbag2.Reader) -> None:
        """Wrap an open reader of rosbags."""
        self.path = path
        self.cdr = isinstance(reader, rosbag2.Reader)
        """True if the messages are ROS 2 CDR, False for ROS 1."""
        self._reader = reader
        self._stores: dict[str, Typestore] = {}
        self._migrated: dict[str, object] = {}

    @cached_property
    def topics(self) -> dict[str, Topic]:
        """All topics by name."""
        by_name = attrgetter('topic')
        return {
            name: Topic(name, members[0].msgtype, sum(item.msgcount for item in members), tuple(members))
            for name, group in groupby(sorted(self._reader.connections, key=by_name), key=by_name)
            for members in [list(group)]
        }

    @cached_property
    def _embedded(self) -> Typestore:
        """The store of the definitions in the recording."""
        return _embedded_store(frozenset((item.msgtype, item.msgdef) for item in self._reader.connections))

    @property
    def start_ns(self) -> int:
        """Time of recording of the first message."""
        return self._reader.start_time

    @property
    def end_ns(self) -> int:
        """Time of recording of the last message."""
        return self._reader.end_time - 1

    @property
    def message_count(self) -> int:
        """Number of messages of all topics."""
        return self._reader.message_count

    def raw_messages(self, topics: Collection[Topic]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic name, time of recording (ns) and content of the messages of some topics.

        Raises:
            RecordingError: the file is damaged.
        """
        connections = [connection for topic in topics for connection in topic.connections]
        if not connections:
            return
        with _damage_as_recording_error(self.path):
            for connection, recorded_ns, raw in self._reader.messages(connections):
                if type(recorded_ns) is not int:  # SQLite keeps what it is given
                    raise ValueError(f'{recorded_ns!r} is not a time')
                yield connection.topic, recorded_ns, raw

    def messages(self, topic: Topic) -> Iterator[Any]:
        """Yield the messages of one topic, completely decoded.

        Raises:
            RecordingError: the file is damaged, or the type of the topic is unknown.
        """
        for _, _, raw in self.raw_messages([topic]):
            yield self.message(topic, raw)

    def first_message(self, topic: Topic) -> Any:
        """Return the first message of a topic that is not damaged, completely decoded.

        Raises:
            RecordingError: there is no such message, or its type is unknown.
        """
        for _, _, raw in self.raw_messages([topic]):
            try:
                return self.message(topic, raw)
            except MessageError:
                continue
        raise RecordingError(
            'has no readable messages', where=f'{self.path}, {topic.name}', todo='record it again'
        )

    def message(self, topic: Topic, raw: bytes) -> Any:
        """Decode one message completely.

        Raises:
            MessageError: the message is damaged.
            RecordingError: its type is unknown.
        """
        store = self._store_of(topic)
        with self._damage_as_message_error(topic):
            if self.cdr:
                return store.deserialize_cdr(raw, topic.type_name)
            return store.deserialize_ros1(raw, topic.type_name)

    def can_publish(self, topic: Topic) -> bool:
        """Return True if ROS 2 can publish the messages of a topic: recorded by ROS 2, or of a known type."""
        return self.cdr or topic.type_name in ros_types().fielddefs

    def as_cdr(self, topic: Topic, raw: bytes) -> bytes:
        """Return one message as ROS 2 sends it (CDR); the topic must be one that it `can_publish`.

        Raises:
            RecordingError: the message is of ROS 1 and damaged.
        """
        if self.cdr:
            return raw
        types, name = ros_types(), topic.type_name
        message = self.message(topic, raw)
        migrated = migrate_message(self._store_of(topic), types, name, name, self._migrated, message)
        return bytes(types.serialize_cdr(migrated, name))

    def reader_of(self, topic: Topic, paths: Sequence[str]) -> FieldReader:
        """Return a function that reads a few fields, see `field_reader`.

        That function raises a `MessageError` if a message is damaged.

        Raises:
            RecordingError: the type of the topic is unknown, or lacks a field.
        """
        store = self._store_of(topic)
        try:
            read = field_reader(store, topic.type_name, paths, cdr=self.cdr)
        except KeyError as error:
            what = f'the definition of {topic.type_name} in the recording is incomplete ({error})'
            raise RecordingError(what, where=f'{self.path}, {topic.name}', todo='record it again') from error

        def checked(raw: bytes) -> tuple[Any, ...]:
            try:
                return read(raw)
            except Exception as error:
                raise self._damaged_message(topic, error) from error

        return checked

    def has_header(self, topic: Topic) -> bool:
        """Return True if the messages of a topic begin with a header.

        Raises:
            RecordingError: the type of the topic is unknown.
        """
        _, fields = self._store_of(topic).fielddefs[topic.type_name]
        return bool(fields) and fields[0][0] == 'header'

    @contextmanager
    def _damage_as_message_error(self, topic: Topic) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # decoding a damaged message can raise any exception
            raise self._damaged_message(topic, error) from error

    def _damaged_message(self, topic: Topic, error: Exception) -> MessageError:
        where = f'{self.path}, {topic.name}'
        return MessageError(f'a message is damaged ({_one_line(error)})', where=where, todo='record it again')

    def _store_of(self, topic: Topic) -> Typestore:
        """Return the store that contains the type of a topic, from a cache after the first call."""
        if topic.type_name not in self._stores:
            self._stores[topic.type_name] = self._find_store(topic)
        return self._stores[topic.type_name]

    def _find_store(self, topic: Topic) -> Typestore:
        """Register the definition in the recording; if it is missing or invalid, use that of ROS 2."""
        name, definition = topic.type_name, topic.connections[0].msgdef
        problem = 'the recording does not define it'
        if definition.format != MessageDefinitionFormat.NONE:
            try:
                known = self._embedded.fielddefs
                types = _parse(definition, name)
                self._embedded.register({other: types[other] for other in types.keys() - known.keys()})
                self._embedded.get_msgdef(name)
                return self._embedded
            except Exception as error:  # the parser raises exceptions of many types on invalid definitions
                problem = f'its definition cannot be parsed: {_one_line(error)}'
        if self.cdr and name in ros_types().fielddefs:
            return ros_types()
        raise RecordingError(
            f'the type {name} is unknown ({problem})',
            where=f'{self.path}, {topic.name}',
            todo='record it with a version of rosbag2 that stores definitions',
        )


def bags_in(folder: Path) -> list[Path]:
    """Return the recordings directly inside a folder, sorted by name, without links to paths outside it.

    Raises:
        RecordingError: there is no such folder.
    """
    if not folder.is_dir():
        raise RecordingError('no such folder', where=str(folder), todo='check the path')
    inside = folder.resolve()
    return sorted(path for path in folder.iterdir() if path.resolve().is_relative_to(inside) and is_bag(path))


def is_bag(path: Path) -> bool:
    """Return True if a path looks like a rosbag2 folder, one of its files, or a ROS 1 `.bag`."""
    if path.is_file():
        return path.suffix in ('.bag', *STORAGE_FILES)
    return (path / 'metadata.yaml').is_file()


@contextmanager
def open_storage(path: Path) -> Iterator[Storage]:
    """Open a recording: a rosbag2 folder, one of its files, or a ROS 1 `.bag`.

    Raises:
        RecordingError: the path does not exist, is not a recording, or the recording is empty or damaged.
    """
    try:
        _require_recording(path)
        require_bounded(path)
    except OSError as error:
        if error.errno == errno.EINVAL:  # by a length in the file that is impossible
            raise _damaged(path, error) from error
        what = f'cannot be read ({error.strerror})'  # for example a name that is too long
        raise RecordingError(what, where=str(path), todo='check the path') from error
    with _damage_as_recording_error(path):
        reader = rosbag1.Reader(path) if path.suffix == '.bag' else rosbag2.Reader(path)
        reader.open()
    try:
        storage = Storage(path, reader)
        with _damage_as_recording_error(path):
            _require_contents(storage)
            _require_each_file_once(reader)
        yield storage
    finally:
        reader.close()


def _require_contents(storage: Storage) -> None:
    """Raise an error unless a recording has messages and a beginning and end; metadata may have any type."""
    if not storage.message_count:
        raise RecordingError('the bag is empty', where=str(storage.path), todo='record it again')
    numbers = [storage.start_ns, storage.end_ns, storage.message_count]
    numbers += [topic.count for topic in storage.topics.values()]
    names = [text for topic in storage.topics.values() for text in (topic.name, topic.type_name)]
    if not all(type(number) is int for number in numbers) or not all(type(name) is str for name in names):
        raise ValueError('a number or a name in its metadata has the wrong type')
    if storage.end_ns - storage.start_ns > MAX_DURATION_NS:
        raise RecordingError(
            'lasts more than a year: the clock of the computer was set meanwhile, or its metadata are wrong',
            where=str(storage.path),
            todo='start recording when the clock is set; keep the messages after that',
        )


def _require_each_file_once(reader: rosbag1.Reader | rosbag2.Reader) -> None:
    """Raise an error if the metadata of a folder list a file twice: its messages would count twice."""
    parts = getattr(getattr(reader, 'storage', None), 'storages', ())  # a folder has them, a file is one
    files = [str(part.path) for part in parts]
    if len(set(files)) < len(files):
        raise ValueError('metadata.yaml lists a file twice')


def _require_recording(path: Path) -> None:
    """Raise an error unless a path looks like a complete recording."""
    if not path.exists():
        raise RecordingError('no such bag', where=str(path), todo='check the path')
    if path.is_file() and path.suffix not in ('.bag', *STORAGE_FILES):
        raise RecordingError(
            'is not a bag', where=str(path), todo='give a rosbag2 folder, an .mcap, a .db3 or a ROS 1 .bag'
        )
    if path.is_dir() and not (path / 'metadata.yaml').exists():
        if any(file.suffix in STORAGE_FILES for file in path.iterdir()):
            raise RecordingError(
                'the recording was not closed properly, metadata.yaml is missing',
                where=str(path),
                todo=f'give a file in it if there is only one, or run: ros2 bag reindex {path}',
            )
        raise RecordingError(
            'is not a bag, there is no metadata.yaml in it', where=str(path), todo='check the path'
        )


@contextmanager
def _damage_as_recording_error(path: Path) -> Iterator[None]:
    """Convert exceptions of the reader, which a damaged file causes, to a `RecordingError`."""
    try:
        yield
    except GyrocalError:
        raise
    except Exception as error:  # a damaged file can make the reader raise any exception
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> RecordingError:
    files = [path] if path.is_file() else sorted(path.glob('*.mcap'))
    is_mcap = bool(files) and files[0].suffix == '.mcap'
    repair = f'mcap recover {files[0].name} -o recovered.mcap' if is_mcap else f'ros2 bag reindex {path}'
    what = f'the bag is damaged or cut short ({_one_line(error)})'
    return RecordingError(what, where=str(path), todo=f'copy it again, or repair it with: {repair}')


def _one_line(error: Exception) -> str:
    return ' '.join(str(error).split()).rstrip('.') or type(error).__name__


def _parse(definition: MessageDefinition, type_name: str) -> dict[str, Any]:
    if definition.format == MessageDefinitionFormat.MSG:
        return dict(get_types_from_msg(definition.data, type_name))
    types: dict[str, Any] = {}
    for part in definition.data.split(IDL_SEPARATOR):
        text = part.split('\n', 1)[1] if part.startswith('IDL: ') else part
        if text.strip():
            types |= get_types_from_idl(text)
    return types


@lru_cache(maxsize=16)
def _embedded_store(definitions: frozenset[tuple[str, MessageDefinition]]) -> Typestore:
    """Return an empty store for the definitions of a recording; recordings with the same ones share it.

    To compile a decoder takes 10 to 40 ms for each type, which the next bag of the same robot saves.
    """
    return get_typestore(Stores.EMPTY)


@cache
def ros_types() -> Typestore:
    """Return the message types of ROS 2."""
    return get_typestore(Stores.ROS2_JAZZY)
