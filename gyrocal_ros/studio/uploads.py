"""Recordings that are dropped on the page: received in pieces, checked, then opened.

Only for browsers on this machine. The pieces of a file are appended on disk, so that nothing large is in
memory, and a recording gets its name only when it is complete and `gyrocal check` finds no error.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import flask
from dash import Dash

from gyrocal_ros.bag.storage import STORAGE_FILES, is_bag
from gyrocal_ros.errors import GyrocalError, RecordingError
from gyrocal_ros.studio.workspace import Workspace

FOLDER = 'uploads'
"""Folder of the received recordings, in the folder for the results."""
PART = '.part_'
"""Start of the name of a recording that is being received."""
ROUTE = '/upload/'
MAX_BYTES = 16 * 2**30
"""Largest recording."""
SPARE_BYTES = 2**30
"""Space that has to be left on the disk."""
SUFFIXES = ('.bag', '.yaml', *STORAGE_FILES)
LONGEST_NAME = 150


def connect_uploads(app: Dash, workspace: Workspace) -> None:
    """Receive recordings from the page: `PUT` for each piece of a file, `POST` for a complete recording."""
    folder = workspace.out / FOLDER
    remove_parts(folder)

    @app.server.put(f'{ROUTE}<bag>/<file>')
    def receive(bag: str, file: str) -> Any:
        at, whole = (flask.request.args.get(name, -1, type=int) for name in ('at', 'whole'))
        piece = flask.request.get_data()
        return _answered(lambda: append(folder, bag, file, piece, at=at, whole=whole), folder)

    @app.server.post(f'{ROUTE}<bag>')
    def finish(bag: str) -> Any:
        usable = workspace.require_usable
        return _answered(lambda: workspace.open_new(complete(folder, bag, workspace.titles, usable)), folder)


def append(folder: Path, bag: str, file: str, piece: bytes, *, at: int, whole: int) -> None:
    """Append a piece to a file of a recording.

    Args:
        folder: folder of the received recordings.
        bag: name of the recording.
        file: name of the file in it.
        piece: the next bytes.
        at: their place in the file; 0 starts the file again.
        whole: size of the whole recording.

    Raises:
        RecordingError: the name or the size is refused, a piece is missing, or the disk is full.
    """
    part = _part(folder, bag)
    if not _is_plain(file) or Path(file).suffix not in SUFFIXES:
        todo = f'give the files of one recording: {", ".join(SUFFIXES)}'
        raise RecordingError('is not a file of a bag', where=file, todo=todo)
    try:
        part.mkdir(parents=True, exist_ok=True)
        path = part / file
        if at == 0:
            path.unlink(missing_ok=True)
        received = sum(other.stat().st_size for other in part.iterdir())
        if max(whole, received + len(piece)) > MAX_BYTES:
            todo = f'the page takes {MAX_BYTES >> 30} GB; give the path to `gyrocal studio` instead'
            raise RecordingError('is too large', where=bag, todo=todo)
        if shutil.disk_usage(part).free < SPARE_BYTES + whole - received:
            todo = 'give the path of the bag to `gyrocal studio`, which copies nothing'
            raise RecordingError('has no place on the disk', where=bag, todo=todo)
        with path.open('ab') as output:
            if output.tell() != at:
                raise RecordingError('a piece of it is missing', where=file, todo='send it again')
            output.write(piece)
    except OSError as error:
        raise RecordingError(f'cannot be written ({error.strerror})', where=str(part)) from error
    except RecordingError:
        shutil.rmtree(part, ignore_errors=True)
        raise


def complete(folder: Path, bag: str, titles: Collection[str], require_usable: Callable[[Path], None]) -> Path:
    """Give a recording its name, when all of its files were received; return its path.

    Args:
        folder: folder of the received recordings.
        bag: name of the recording.
        titles: titles that are in use.
        require_usable: raises an error for a recording that cannot be used.

    Raises:
        GyrocalError: no bag was received, it cannot be used, or its name is in use.
    """
    part = _part(folder, bag)
    files = sorted(part.iterdir()) if part.is_dir() else []
    found = part if is_bag(part) else files[0] if len(files) == 1 and is_bag(files[0]) else None
    try:
        if found is None:
            todo = 'give one .mcap, .db3 or .bag, or a folder with metadata.yaml and its files'
            raise RecordingError('is not a bag', where=bag, todo=todo)
        path = folder / (bag if found == part else found.name)
        if path.exists() or path.name in titles:
            raise RecordingError('is the name of another bag here', where=path.name, todo='rename it')
        require_usable(found)
        found.rename(path)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return path


def remove_parts(folder: Path) -> None:
    """Remove what an interrupted studio has left."""
    for part in folder.glob(f'{PART}*'):
        shutil.rmtree(part, ignore_errors=True)


def _part(folder: Path, bag: str) -> Path:
    if not _is_plain(bag):
        raise RecordingError('is not a usable name for a bag', where=bag, todo='rename it')
    return folder / f'{PART}{bag}'


def _is_plain(name: str) -> bool:
    """Return True if a name is that of an ordinary file in a folder, and nothing else."""
    is_printable = name.isprintable() and len(name.encode()) <= LONGEST_NAME
    return is_printable and not name.startswith('.') and not set(name) & set('/\\')


def _answered(work: Callable[[], None], folder: Path) -> flask.Response:
    """Do the work of a request; an error is its answer, as text for the page."""
    try:
        work()
    except GyrocalError as error:
        return flask.Response(str(error).replace(f'{folder}/{PART}', ''), 400, mimetype='text/plain')
    return flask.Response(status=204)
