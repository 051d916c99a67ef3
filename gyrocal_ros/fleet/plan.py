"""List of the bags of a fleet, from folders, patterns, or a table; on any file system that fsspec knows."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from gyrocal_ros.errors import GyrocalError

TABLES = ('.csv', '.parquet')
BAG_FILES = ('.mcap', '.db3', '.bag')
METADATA = 'metadata.yaml'
"""File that makes a folder a rosbag2 bag."""


@dataclass(frozen=True, slots=True)
class PlannedBag:
    """One bag of the fleet."""

    bag: str
    """Absolute path, or URL."""
    robot: str
    columns: Mapping[str, Any] = field(default_factory=dict)
    """Further columns of the table, as `time` and `age_h`."""


def plan_bags(places: Sequence[str]) -> list[PlannedBag]:
    """List the bags of a fleet, ordered by robot and bag.

    Args:
        places: folders, which are searched, bags, patterns, or tables (CSV or Parquet) with the columns
            `bag`, `robot`, and any others. Paths in a table are relative to it. Without a table the robot
            is the name of the folder that contains the bag.

    Raises:
        GyrocalError: there is no bag, a table cannot be read, or a bag is named with two robots.
    """
    planned: dict[str, PlannedBag] = {}
    for place in places:
        for item in _of_table(place) if place.endswith(TABLES) else _found(place):
            known = planned.setdefault(item.bag, item)
            if known.robot != item.robot:
                what = f'is listed for two robots, {known.robot} and {item.robot}'
                raise GyrocalError(what, where=item.bag, todo='correct the table')
    return sorted(planned.values(), key=lambda item: (item.robot, item.bag))


def _found(place: str) -> Iterator[PlannedBag]:
    fs, root = _file_system(place)
    paths = sorted(fs.glob(root)) if any(sign in root for sign in '*?[') else [root]
    bags = [bag for path in paths for bag in _bags_below(fs, path)]
    if not bags:
        todo = 'give a folder with bags, a pattern, or a table with the columns bag and robot'
        raise GyrocalError('contains no bag', where=place, todo=todo)
    for bag in bags:
        yield PlannedBag(_as_url(fs, bag), PurePosixPath(bag).parent.name)


def _bags_below(fs: Any, path: str) -> list[str]:
    """Return the bags at or below a path: folders with metadata, and bag files outside of such."""
    if not fs.exists(path):
        return []
    if not fs.isdir(path):
        return [path] if path.endswith(BAG_FILES) else []
    files = fs.find(path)
    folders = {str(PurePosixPath(file).parent) for file in files if PurePosixPath(file).name == METADATA}
    single = (file for file in files if file.endswith(BAG_FILES))
    return sorted([*folders, *(file for file in single if str(PurePosixPath(file).parent) not in folders)])


def _of_table(place: str) -> Iterator[PlannedBag]:
    """Yield the bags of a table."""
    from pyarrow import ArrowException, csv, parquet, string

    fs, path = _file_system(place)
    try:
        with fs.open(path, 'rb') as file:
            names = csv.ConvertOptions(column_types={'bag': string(), 'robot': string()})
            is_text = path.endswith('.csv')
            table = csv.read_csv(file, convert_options=names) if is_text else parquet.read_table(file)
        missing = {'bag', 'robot'} - set(table.column_names)
    except (OSError, UnicodeDecodeError, ArrowException) as error:
        raise GyrocalError(
            f'cannot be read ({error})', where=place, todo='give a CSV or Parquet file'
        ) from error
    if missing:
        raise GyrocalError(
            f'has no column {" and ".join(sorted(missing))}', where=place, todo='a row needs bag and robot'
        )
    folder = PurePosixPath(path).parent
    for row in table.to_pylist():
        bag, robot = str(row.pop('bag')), str(row.pop('robot'))
        inside = bag if '://' in bag or bag.startswith('/') else _as_url(fs, str(folder / bag))
        yield PlannedBag(inside, robot, {name: _plain(value) for name, value in row.items()})


def _plain(value: Any) -> Any:
    """Return a value of a table as a number, a truth value or text; None for an empty cell."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    if isinstance(value, bool | int | float | str):
        return value
    return value.isoformat() if hasattr(value, 'isoformat') else str(value)


def _file_system(place: str) -> tuple[Any, str]:
    """Return the file system of a path or URL, and the path in it.

    Raises:
        GyrocalError: fsspec cannot open this kind of URL.
    """
    from fsspec.core import url_to_fs

    try:
        fs, path = url_to_fs(place)
    except (ImportError, ValueError) as error:
        todo = 'use a local path, or install the package that fsspec names'
        raise GyrocalError(f'cannot be opened ({error})', where=place, todo=todo) from error
    return fs, path


def _as_url(fs: Any, path: str) -> str:
    """Return the full name of a path: a local one unchanged, any other one with its protocol."""
    protocols: Iterable[str] = (fs.protocol,) if isinstance(fs.protocol, str) else fs.protocol
    return path if 'file' in protocols else str(fs.unstrip_protocol(path))
