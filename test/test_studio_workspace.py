"""The workspace of a studio: its recordings and the open session."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from studio_parts import IdleWorker

from gyrocal_ros.cli.studio import named_apart
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask
from gyrocal_ros.studio.store import locked
from gyrocal_ros.studio.tasks import Failed, OpenRecording
from gyrocal_ros.studio.workspace import Workspace


@pytest.fixture
def worker() -> IdleWorker:
    return IdleWorker()


@pytest.fixture
def workspace(worker: IdleWorker, tmp_path: Path) -> Iterator[Workspace]:
    bags = [Bag(tmp_path / name, Config()) for name in ('one', 'two')]
    workspace = Workspace(bags, default_model(), Config(), tmp_path / 'out', worker)
    yield workspace
    workspace.close()


def opened_recording(worker: IdleWorker) -> Bag | HiddenEffectTask:
    task = worker.tasks[-1]
    assert isinstance(task, OpenRecording)
    return task.recording


def test_models_are_tested_on_recordings_of_the_studio_only(workspace: Workspace, worker: IdleWorker) -> None:
    with pytest.raises(GyrocalError, match='no such recording'):
        workspace.validate_on(2)
    worker.send(1, Failed('no'))  # nothing is running any more
    with pytest.raises(GyrocalError, match='used to fit'):
        workspace.validate_on(0)
    with pytest.raises(GyrocalError, match='has not run'):
        workspace.validate_on(1)


def test_bags_of_the_same_name_are_named_by_their_folders(tmp_path: Path) -> None:
    bags = [tmp_path / day / 'kitchen' for day in ('monday', 'tuesday')] + [tmp_path / 'hall']
    found = named_apart([('', bag) for bag in (*bags, bags[0])])
    assert found == list(zip(('monday_kitchen', 'tuesday_kitchen', 'hall'), bags, strict=True))
    with pytest.raises(GyrocalError, match='name of several bags'):
        named_apart([('', tmp_path / disk / 'monday' / 'kitchen') for disk in 'ab'])


def test_the_first_is_opened_and_another_can_be_chosen(workspace: Workspace, worker: IdleWorker) -> None:
    assert workspace.titles == ['one', 'two'] and opened_recording(worker).title == 'one'
    workspace.choose(1)
    assert opened_recording(worker).title == workspace.state.title == 'two' and worker.cancelled
    assert workspace.session.folder.name == 'two'
    workspace.choose(1)
    assert len(worker.tasks) == 2, 'a recording that is open is not opened again'
    workspace.choose(0)
    assert workspace.state.title == 'one', 'its folder was released'


def test_the_open_session_stays_if_another_cannot_be_opened(
    workspace: Workspace, worker: IdleWorker, tmp_path: Path
) -> None:
    with locked(tmp_path / 'out' / 'two'), pytest.raises(GyrocalError, match='another studio'):
        workspace.choose(1)
    assert workspace.state.title == 'one'
    with pytest.raises(GyrocalError, match='another studio'), locked(tmp_path / 'out' / 'one'):
        pass


@pytest.mark.parametrize('number', [-1, 2])
def test_unknown_recordings_cannot_be_chosen(workspace: Workspace, number: int) -> None:
    with pytest.raises(GyrocalError, match='no such recording'):
        workspace.choose(number)


def test_hidden_effect_tasks_have_a_random_seed_unless_one_is_given(
    workspace: Workspace, worker: IdleWorker
) -> None:
    workspace.draw_task(7)
    assert (
        opened_recording(worker) == HiddenEffectTask(7, Config())
        and workspace.state.title == 'lesson_7'
        and workspace.state.has_answer
    )
    seeds = set()
    for _ in range(5):
        workspace.draw_task()
        recording = opened_recording(worker)
        assert isinstance(recording, HiddenEffectTask)
        seeds.add(recording.seed)
    assert len(seeds) > 1


def test_messages_about_the_earlier_recording_are_ignored(workspace: Workspace, worker: IdleWorker) -> None:
    workspace.choose(1)
    worker.send(1, Failed('of the first'))
    assert not workspace.state.is_error
    worker.send(2, Failed('of the second'))
    assert workspace.state.is_error


def test_close_ends_the_worker_and_unlocks_the_folder(
    workspace: Workspace, worker: IdleWorker, tmp_path: Path
) -> None:
    workspace.close()
    assert worker.closed == 1
    again = Workspace(
        [Bag(tmp_path / 'one', Config())], default_model(), Config(), tmp_path / 'out', IdleWorker()
    )
    again.close()
