"""Files that are installed with the package, and atomic output of results.

Results appear completely or not at all: they are written under a temporary name and renamed when
complete.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.errors import GyrocalError


def shipped(name: str) -> Path:
    """Find a file or folder that is installed with the package, such as `bags` or `config/model.yaml`.

    In a checkout it is beside the package; colcon and pip install it into `share/gyrocal_ros` below the
    prefix that contains the package.

    Raises:
        GyrocalError: it is not installed.
    """
    package = Path(__file__).resolve().parent
    checkout = package.parent
    shares = [parent / 'share' / package.name for parent in package.parents]
    places = [checkout] if (checkout / 'package.xml').is_file() else shares
    for place in places:
        if (place / name).exists():
            return place / name
    raise GyrocalError(
        f'{name} is not installed', where=package.name, todo='install the package with pip or colcon'
    )


def write_text_atomic(path: Path, text: str, *, overwrite: bool = False) -> None:
    """Write a UTF-8 text file in one step.

    Args:
        path: the file; missing parent folders are created.
        text: its content.
        overwrite: replace an existing file.

    Raises:
        GyrocalError: the file exists and may not be replaced, or cannot be written.
    """
    path = path.resolve()
    if path.exists() and not overwrite:
        raise GyrocalError('exists already', where=str(path), todo='choose another name or give --overwrite')
    part = _temporary_path(path)
    with _reported_os_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open('w', encoding='utf-8') as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())  # a robot may lose power at any time
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)


def json_text(values: Mapping[str, Any]) -> str:
    """Return a JSON object with a line end; non-finite numbers become null, arrays become lists."""
    return json.dumps(_plain(values), indent=2, ensure_ascii=False, allow_nan=False) + '\n'


@contextmanager
def new_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to `path` on success and removed on failure.

    Enter the context before the work starts: a folder that may not be written is then refused at once.

    Args:
        path: the folder to create; missing parents are created, and an existing empty one is accepted.
        overwrite: accept a folder that contains files. Files of the same name are replaced, all others
            are kept, so that no file of the user is lost by a mistyped path.

    Raises:
        GyrocalError: the folder contains files and may not be written, or cannot be created.
    """
    path = path.resolve()
    if path.is_file():
        raise GyrocalError('is a file, not a folder', where=str(path), todo='choose another name')
    with _reported_os_errors(path):
        occupied = path.is_dir() and any(path.iterdir())
        if occupied and not overwrite:
            raise GyrocalError(
                'is not empty', where=str(path), todo='choose another name or give --overwrite'
            )
        part = _temporary_path(path)
        part.mkdir(parents=True)
    try:
        yield part
        with _reported_os_errors(path):
            if occupied:
                _move_files(part, path)
            else:
                part.replace(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _temporary_path(path: Path) -> Path:
    """Return the temporary name beside `path`, so that renaming stays within one file system."""
    return path.parent / f'.{path.name}.{os.getpid()}.part'


def _move_files(source: Path, target: Path) -> None:
    for file in sorted(item for item in source.rglob('*') if not item.is_dir()):
        place = target / file.relative_to(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        file.replace(place)


@contextmanager
def _reported_os_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise GyrocalError(
            f'cannot be written ({error.strerror})',
            where=str(path),
            todo='check the path and its permissions',
        ) from error
