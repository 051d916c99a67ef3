"""Reads a few fields of a serialised message and skips the rest.

An Imu message carries three covariance matrices and an orientation that nobody here asks for; to
build all of it costs six times as much as to pick the eight numbers that count. The layout follows
from the message definition, so the same code reads CDR (ROS 2) and ROS 1 messages of any type.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from struct import Struct
from typing import Any, NamedTuple, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

FieldReader: TypeAlias = Callable[[bytes], tuple[Any, ...]]

CODES = {
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
WIDEST = 8


class _Item(NamedTuple):
    """One thing on the wire: a number, some numbers in a row, or a counted run of them."""

    path: str
    code: str
    """`struct` code of one number."""
    length: int = 1
    """How many follow each other."""
    counted: bool = False
    """Whether the count itself is on the wire, before the numbers: a string or a sequence."""


class _Block(NamedTuple):
    """Numbers at fixed distances from each other, then perhaps a counted run to jump over."""

    align: int
    layout: Struct
    run_item: Struct | None
    """One item of the run whose count is the last value of the block."""


class _NotFlat(Exception):
    """The wanted fields lie behind something whose length shows only when it is decoded."""


def field_reader(store: Typestore, type_name: str, paths: Sequence[str], *, cdr: bool) -> FieldReader:
    """Return a function from a serialised message to the values of some of its number fields.

    Args:
        store: holds the definition of the type.
        type_name: for example `sensor_msgs/msg/Imu`.
        paths: dotted names such as `header.stamp.sec`, in the order of the definition.
        cdr: the messages are ROS 2 CDR, not ROS 1.
    """

    def read_all(raw: bytes) -> tuple[Any, ...]:
        message = store.deserialize_cdr(raw, type_name) if cdr else store.deserialize_ros1(raw, type_name)
        values = attrgetter(*paths)(message)
        return values if len(paths) > 1 else (values,)

    origin = 4 if cdr else 0  # CDR opens with four bytes that say how the rest is encoded
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
        for align, layout, run_item in before:
            position += (origin - position) % align
            values += layout.unpack_from(raw, position)
            position += layout.size
            if run_item and (count := values.pop()):
                if cdr:
                    position += (origin - position) % run_item.size
                position += count * run_item.size
        return *values, *last_values(raw, position + (origin - position) % last_align)

    return read


def _items(definitions: Mapping[str, Any], type_name: str, prefix: str) -> Iterator[_Item]:
    """Yield what a message consists of, nested messages laid open, in the order of the wire."""
    for name, (kind, about) in definitions[type_name][1]:
        path = prefix + name
        if kind == Nodetype.NAME:
            yield from _items(definitions, about, f'{path}.')
        elif kind == Nodetype.BASE:
            yield _Item(path, 'B', counted=True) if about[0] == 'string' else _Item(path, _code(about[0]))
        else:
            (item_kind, item_about), count = about
            if item_kind == Nodetype.NAME and kind == Nodetype.ARRAY:
                for index in range(count):
                    yield from _items(definitions, item_about, f'{path}[{index}].')
            elif item_kind == Nodetype.NAME or item_about[0] == 'string':
                raise _NotFlat(path)
            else:
                code = _code(item_about[0])
                yield (
                    _Item(path, code, counted=True) if kind == Nodetype.SEQUENCE else _Item(path, code, count)
                )


def _code(base_type: str) -> str:
    if base_type not in CODES:
        raise _NotFlat(base_type)
    return CODES[base_type]


def _blocks(items: Iterator[_Item], wanted: list[str], cdr: bool) -> Iterator[_Block]:
    """Yield the blocks up to the last wanted field.

    Where CDR aligns a number more strictly than its block is known to lie, a new block begins.
    """
    align, layout = WIDEST, '<'
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
