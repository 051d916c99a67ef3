"""The recordings that a studio was given, by number, and the one that is open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask
from gyrocal_ros.studio.store import locked
from gyrocal_ros.studio.worker import Failed, News, OpenRecording, Task
from gyrocal_ros.studio.workspace import Workspace


class Worker:
    """Takes tasks and does none of them."""

    def __init__(self) -> None:
        self.tasks: list[Task] = []
        self.cancelled = self.closed = 0

    def listen(self, listener: Callable[[int, News], None]) -> None:
        self.tell = listener

    def submit(self, task: Task) -> int:
        self.tasks.append(task)
        return len(self.tasks)

    def cancel(self) -> None:
        self.cancelled += 1

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def worker() -> Worker:
    return Worker()


@pytest.fixture
def desk(worker: Worker, tmp_path: Path) -> Iterator[Workspace]:
    bags = [Bag(tmp_path / name, Config()) for name in ('one', 'two')]
    desk = Workspace(bags, default_model(), Config(), tmp_path / 'out', worker)
    yield desk
    desk.close()


def opened(worker: Worker) -> Bag | HiddenEffectTask:
    task = worker.tasks[-1]
    assert isinstance(task, OpenRecording)
    return task.recording


def test_the_first_is_opened_and_another_can_be_chosen(desk: Workspace, worker: Worker) -> None:
    assert desk.titles == ['one', 'two'] and opened(worker).title == 'one'
    desk.choose(1)
    assert opened(worker).title == desk.view.title == 'two' and worker.cancelled
    assert desk.session.folder.name == 'two'
    desk.choose(1)
    assert len(worker.tasks) == 2, 'it is open already'
    desk.choose(0)
    assert desk.view.title == 'one', 'its folder was let go of'


def test_what_cannot_be_opened_leaves_the_other_as_it_was(
    desk: Workspace, worker: Worker, tmp_path: Path
) -> None:
    with locked(tmp_path / 'out' / 'two'), pytest.raises(GyrocalError, match='another studio'):
        desk.choose(1)
    assert desk.view.title == 'one'
    with pytest.raises(GyrocalError, match='another studio'), locked(tmp_path / 'out' / 'one'):
        pass


@pytest.mark.parametrize('number', [-1, 2])
def test_what_was_not_given_cannot_be_chosen(desk: Workspace, number: int) -> None:
    with pytest.raises(GyrocalError, match='no such recording'):
        desk.choose(number)


def test_a_riddle_is_drawn_anew_each_time_or_by_its_seed(desk: Workspace, worker: Worker) -> None:
    desk.draw_riddle(7)
    assert (
        opened(worker) == HiddenEffectTask(7, Config())
        and desk.view.title == 'lesson_7'
        and desk.view.has_answer
    )
    seeds = set()
    for _ in range(5):
        desk.draw_riddle()
        recording = opened(worker)
        assert isinstance(recording, HiddenEffectTask)
        seeds.add(recording.seed)
    assert len(seeds) > 1


def test_news_of_a_recording_that_was_left_do_not_reach_the_next(desk: Workspace, worker: Worker) -> None:
    desk.choose(1)
    worker.tell(1, Failed('of the first'))
    assert not desk.view.is_trouble
    worker.tell(2, Failed('of the second'))
    assert desk.view.is_trouble


def test_everything_ends_with_it(desk: Workspace, worker: Worker, tmp_path: Path) -> None:
    desk.close()
    assert worker.closed == 1
    again = Workspace(
        [Bag(tmp_path / 'one', Config())], default_model(), Config(), tmp_path / 'out', Worker()
    )
    again.close()
