"""Files that are installed with the package, and atomic output of results.

Results appear completely or not at all: they are written under a temporary name and renamed when
complete.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.errors import GyrocalError

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""Constants of the system call renameat2, see its manual page."""


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
    with _reported_os_errors(path):
        path = path.resolve()
        if path.exists() and not overwrite:
            todo = 'choose another name or give --overwrite'
            raise GyrocalError('exists already', where=str(path), todo=todo)
        part = _temporary_path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        _recover(path)
        try:
            with part.open('w', encoding='utf-8', errors='replace') as file:  # names need not be UTF-8
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
            are kept, so that no file of the user is lost by a mistyped path. The folder is exchanged as a
            whole: after an interruption it holds the old files or the new ones, never some of each.

    Raises:
        GyrocalError: the folder contains files and may not be written, or cannot be created.
    """
    with _reported_os_errors(path):
        path = path.resolve()
        if path.is_file():
            raise GyrocalError('is a file, not a folder', where=str(path), todo='choose another name')
        path.parent.mkdir(parents=True, exist_ok=True)
        _recover(path)
        occupied = path.is_dir() and any(path.iterdir())
        if occupied and not overwrite:
            raise GyrocalError(
                'is not empty', where=str(path), todo='choose another name or give --overwrite'
            )
        part = _temporary_path(path)
        part.mkdir()
    try:
        yield part
        with _reported_os_errors(path):
            if occupied:
                _link_other_files(path, part)
                _exchange(part, path)
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
    """Return a temporary name beside `path` that no other process uses, in the same file system.

    It holds the process, by which abandoned ones are recognised, and a random part: after a restart of the
    computer another process may have the same number. A long name is shortened, as a name has 255 bytes.
    """
    return path.parent / f'.{_short(path.name)}.{os.getpid()}.{secrets.token_hex(4)}.part'


def _short(name: str) -> str:
    return os.fsdecode(os.fsencode(name)[:200])


def _link_other_files(folder: Path, part: Path) -> None:
    """Add the files of a folder that have no successor to the folder that will replace it."""
    for file in sorted(folder.rglob('*')):
        place = part / file.relative_to(folder)
        if file.is_dir() and not file.is_symlink():
            place.mkdir(exist_ok=True)
        elif not place.exists() and not place.is_symlink():
            place.parent.mkdir(parents=True, exist_ok=True)
            try:
                os.link(file, place, follow_symlinks=False)
            except OSError:  # a file system without hard links
                shutil.copy2(file, place, follow_symlinks=False)


def _exchange(part: Path, path: Path) -> None:
    """Exchange a folder for its successor, which then has the name of the temporary one.

    Linux does this in one step. Elsewhere it takes two renames, and after an interruption between them
    `_recover` puts the old folder back.
    """
    renameat2 = getattr(ctypes.CDLL(None), 'renameat2', None)
    names = AT_FDCWD, os.fsencode(part), AT_FDCWD, os.fsencode(path)
    if renameat2 is not None and renameat2(*names, RENAME_EXCHANGE) == 0:
        return
    old = path.with_name(f'{part.name}.old')
    path.replace(old)
    try:
        part.replace(path)
    except BaseException:
        old.replace(path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _recover(path: Path) -> None:
    """Remove temporary files of processes that were killed; put back a folder that one had renamed."""
    pattern = re.compile(rf'\.{re.escape(_short(path.name))}\.(\d+)\.[0-9a-f]{{8}}\.part(\.old)?')
    for item in path.parent.iterdir():
        match = pattern.fullmatch(item.name)
        if match is None or _is_running(int(match[1])):
            continue
        if match[2] and not path.exists():
            item.replace(path)
        elif item.is_dir():
            shutil.rmtree(item, ignore_errors=True)
        else:
            item.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@contextmanager
def _reported_os_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links; a NUL in the name
        raise GyrocalError(
            f'cannot be written ({getattr(error, "strerror", None) or "no such place"})',
            where=str(path),
            todo='check the path and its permissions',
        ) from error
