"""The folder of a session, which survives a reload, a second tab and a killed server.

    studio.json          the recording, the tree of revisions, and the present one
    0_default/           a revision as of `gyrocal improve`: model.yaml, calibration.yaml, merit.json
    1_scale_asymmetry/
    model.yaml  calibration.yaml  history.json      results of the present revision, on request

A revision is complete before studio.json names it, and each file is replaced in one step. So the folder
is consistent at any time at which a server may be killed.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gyrocal_ros.diagnose.search.improvement import Improvement, Revision
from gyrocal_ros.effects.model_file import load_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import json_text, new_folder, write_text_atomic
from gyrocal_ros.report.write import fill_result, fill_revision
from gyrocal_ros.studio.revisions import ModelTree, TriedModel

STATE = 'studio.json'
LOCK = '.lock'


def load(folder: Path, recording: Mapping[str, Any]) -> ModelTree:
    """Load the tried models of an earlier session; an empty tree if the folder is new.

    Args:
        folder: folder of the session.
        recording: properties that distinguish the recording from others.

    Raises:
        GyrocalError: the folder belongs to another recording, or is damaged.
    """
    path = folder / STATE
    if not path.is_file():
        return ModelTree()
    todo = 'give another folder with -o, or move this one away'
    try:
        saved = json.loads(path.read_text(encoding='utf-8'))
        is_same, present, revisions = saved['recording'] == recording, saved['present'], saved['revisions']
        names = [(str(item['label']), item['builds_on']) for item in revisions]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise GyrocalError('is damaged', where=str(path), todo=todo) from error
    if not is_same:
        raise GyrocalError('belongs to another recording', where=str(folder), todo=todo)
    folders = {path.name for path in folder.iterdir()}  # a label is a name in this folder, not a path
    if not {label for label, _ in names} <= folders or present not in dict(names):
        raise GyrocalError('names revisions that do not exist', where=str(path), todo=todo)
    models = tuple(
        TriedModel(label, builds_on, load_model(folder / label / 'model.yaml')) for label, builds_on in names
    )
    return ModelTree(models, present)


def save_revision(folder: Path, revision: Revision) -> None:
    """Write a new revision.

    Raises:
        GyrocalError: it cannot be written.
    """
    with new_folder(folder / revision.label, overwrite=True) as part:
        fill_revision(part, revision)


def save_state(folder: Path, recording: Mapping[str, Any], tree: ModelTree) -> None:
    """Write the tree of revisions, and which one is the present one.

    Raises:
        GyrocalError: it cannot be written.
    """
    state = {
        'recording': recording,
        'present': tree.present_label,
        'revisions': [{'label': tried.label, 'builds_on': tried.builds_on} for tried in tree.models],
    }
    write_text_atomic(folder / STATE, json_text(state), overwrite=True)


def save_result(folder: Path, improved: Improvement) -> None:
    """Write the present model and its calibration for the robot, and the history as JSON.

    Raises:
        GyrocalError: they cannot be written.
    """
    with new_folder(folder, overwrite=True) as part:
        fill_result(part, improved)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for other servers; the lock ends with the process, even if that is killed.

    Raises:
        GyrocalError: another studio uses the folder, or it cannot be made.
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
                'another studio uses it',
                where=str(folder),
                todo='close that one, or choose another with -o',
            ) from error
        yield
