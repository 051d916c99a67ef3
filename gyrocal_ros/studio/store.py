"""The folder of a session: what survives a reload, a second tab and a killed server.

    studio.json          which recording, what builds on what, and which one is the present one
    0_default/           a revision, as `gyrocal improve` leaves it: model.yaml, calibration.yaml, merit.json
    1_scale_asymmetry/
    model.yaml  calibration.yaml  history.json      the present one, once it was written

A revision is complete before studio.json names it, and each file is replaced in one step; so whatever
moment a server is killed at, the folder tells of a state that a person has seen.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gyrocal_ros.diagnose.improvement import Improvement, Revision
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import json_text, new_folder, write_text_atomic
from gyrocal_ros.report.write import fill_result, fill_revision
from gyrocal_ros.studio.revisions import ModelTree, TriedModel

STATE = 'studio.json'
LOCK = '.lock'


def load(folder: Path, recording: Mapping[str, Any]) -> ModelTree:
    """What was tried before; nothing where the folder is new.

    Args:
        folder: of the session.
        recording: what tells the recording from others.

    Raises:
        GyrocalError: the folder is that of another recording, or damaged.
    """
    path = folder / STATE
    if not path.is_file():
        return ModelTree()
    todo = 'give another folder with -o, or move this one away'
    try:
        saved = json.loads(path.read_text(encoding='utf-8'))
        same, present, revisions = saved['recording'] == recording, saved['present'], saved['revisions']
        names = [(str(item['label']), item['builds_on']) for item in revisions]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise GyrocalError('is damaged', where=str(path), todo=todo) from error
    if not same:
        raise GyrocalError('belongs to another recording', where=str(folder), todo=todo)
    known = {path.name for path in folder.iterdir()}  # a label is the name of a folder here, no path
    if not {label for label, _ in names} <= known or present not in dict(names):
        raise GyrocalError('names revisions that are not there', where=str(path), todo=todo)
    every = tuple(
        TriedModel(label, builds_on, load_model(folder / label / 'model.yaml')) for label, builds_on in names
    )
    return ModelTree(every, present)


def save_revision(folder: Path, revision: Revision) -> None:
    """Write a revision that is new.

    Raises:
        GyrocalError: it cannot be written.
    """
    with new_folder(folder / revision.label, overwrite=True) as part:
        fill_revision(part, revision)


def save_state(folder: Path, recording: Mapping[str, Any], trials: ModelTree) -> None:
    """Write which revisions count, and which one is the present one.

    Raises:
        GyrocalError: it cannot be written.
    """
    state = {
        'recording': recording,
        'present': trials.present,
        'revisions': [{'label': trial.label, 'builds_on': trial.builds_on} for trial in trials.every],
    }
    write_text_atomic(folder / STATE, json_text(state), overwrite=True)


def save_result(folder: Path, improved: Improvement) -> None:
    """Write the present model and its calibration for the robot, and the history for programs.

    Raises:
        GyrocalError: they cannot be written.
    """
    with new_folder(folder, overwrite=True) as part:
        fill_result(part, improved)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other servers out of a folder; the lock ends with the process, however that ends.

    Raises:
        GyrocalError: another studio works in it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / LOCK).open('w')
    except OSError as error:
        raise GyrocalError(
            f'cannot be written ({error.strerror})', where=str(folder), todo='choose another with -o'
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise GyrocalError(
                'another studio works in it',
                where=str(folder),
                todo='close that one, or choose another with -o',
            ) from error
        yield
