"""Reads a few fields of a serialised message and skips the rest.

An Imu message carries three covariance matrices and an orientation that are not used here; decoding all
of it takes six times as long as reading the eight numbers that are used. The layout follows from the
message definition, so the same code reads CDR (ROS 2) and ROS 1 messages of any type.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from struct import Struct
from typing import Any, NamedTuple, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

FieldReader: TypeAlias = Callable[[bytes], tuple[Any, ...]]
"""Function from a serialised message to the values of the selected fields."""

STRUCT_CODES = {
    'bool': '?',
    'byte': 'b',
    'char': 'B',
    'int8': 'b',
    'uint8': 'B',
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'float32': 'f',
    'float64': 'd',
}
"""`struct` code of each numeric type."""
MAX_ALIGNMENT = 8
"""Largest alignment of a number in CDR, in bytes."""


class _Item(NamedTuple):
    """One element of a serialised message: a number, an array of numbers, or a counted sequence of them."""

    path: str
    code: str
    """`struct` code of one number."""
    length: int = 1
    """Number of numbers in the array."""
    counted: bool = False
    """True if the count is serialised before the numbers, as in a string or a sequence."""


class _Block(NamedTuple):
    """Numbers at fixed offsets from each other, optionally followed by a counted sequence to skip."""

    align: int
    layout: Struct
    sequence_item: Struct | None
    """Layout of one item of the sequence whose count is the last value of the block; None without one."""


class _NotFlat(Exception):
    """A wanted field follows something whose length is only known after decoding it."""


def field_reader(store: Typestore, type_name: str, paths: Sequence[str], *, cdr: bool) -> FieldReader:
    """Return a function from a serialised message to the values of some of its numeric fields.

    Args:
        store: store with the definition of the type.
        type_name: for example `sensor_msgs/msg/Imu`.
        paths: dotted names such as `header.stamp.sec`, in the order of the definition.
        cdr: True if the messages are ROS 2 CDR, False for ROS 1.
    """

    def read_all(raw: bytes) -> tuple[Any, ...]:
        message = store.deserialize_cdr(raw, type_name) if cdr else store.deserialize_ros1(raw, type_name)
        values = attrgetter(*paths)(message)
        values = values if len(paths) > 1 else (values,)
        for path, value in zip(paths, values, strict=True):
            if not isinstance(value, (int, float)):
                raise TypeError(f'{path} is not a number')
        return values

    origin = 4 if cdr else 0  # CDR starts with four bytes that define the encoding of the rest
    try:
        items = _items(store.fielddefs, type_name, '')
        *before, last = _blocks(items, list(paths), cdr)
    except _NotFlat:
        return read_all
    last_align, last_values = last.align, last.layout.unpack_from

    def read(raw: bytes) -> tuple[Any, ...]:
        if cdr and not raw[1]:  # big-endian
            return read_all(raw)
        values: list[Any] = []
        position = origin
        for align, layout, sequence_item in before:
            position += (origin - position) % align
            values += layout.unpack_from(raw, position)
            position += layout.size
            if sequence_item and (count := values.pop()):
                if cdr:
                    position += (origin - position) % sequence_item.size
                position += count * sequence_item.size
        return *values, *last_values(raw, position + (origin - position) % last_align)

    return read


def _items(definitions: Mapping[str, Any], type_name: str, prefix: str) -> Iterator[_Item]:
    """Yield the elements of a message in the order of serialisation, nested messages flattened."""
    for name, (kind, details) in definitions[type_name][1]:
        path = prefix + name
        if kind == Nodetype.NAME:
            yield from _items(definitions, details, f'{path}.')
        elif kind == Nodetype.BASE:
            yield _Item(path, 'B', counted=True) if details[0] == 'string' else _Item(path, _code(details[0]))
        else:
            (item_kind, item_details), count = details
            if item_kind == Nodetype.NAME and kind == Nodetype.ARRAY:
                for index in range(count):
                    yield from _items(definitions, item_details, f'{path}[{index}].')
            elif item_kind == Nodetype.NAME or item_details[0] == 'string':
                raise _NotFlat(path)
            else:
                code = _code(item_details[0])
                yield (
                    _Item(path, code, counted=True) if kind == Nodetype.SEQUENCE else _Item(path, code, count)
                )


def _code(base_type: str) -> str:
    if base_type not in STRUCT_CODES:
        raise _NotFlat(base_type)
    return STRUCT_CODES[base_type]


def _blocks(items: Iterator[_Item], wanted: list[str], cdr: bool) -> Iterator[_Block]:
    """Yield the blocks up to the last wanted field.

    A number that CDR aligns more strictly than the start of its block begins a new block.
    """
    align, layout = MAX_ALIGNMENT, '<'
    while wanted:
        item = next(items, None)
        if item is None:
            raise _NotFlat(wanted[0])
        size = 4 if item.counted else Struct(item.code).size
        width = size if cdr else 1
        if width > align:
            if layout != '<':
                yield _Block(align, Struct(layout), None)
            align, layout = width, '<'
        layout += 'x' * (-Struct(layout).size % width)
        if item.counted:
            yield _Block(align, Struct(f'{layout}I'), Struct(item.code))
            align, layout = 1, '<'
        elif item.path == wanted[0]:
            layout += item.code
            del wanted[0]
        else:
            layout += f'{item.length * size}x'
    yield _Block(align, Struct(layout), None)
