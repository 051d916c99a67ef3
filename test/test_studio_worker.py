"""The process that does the long work: it tells, it stops when told to, and its end is noticed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Condition

import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.studio.recordings import Bag, Contents, HiddenEffectTask
from gyrocal_ros.studio.worker import Advance, Failed, News, OpenRecording, Ready, Stopped, Worker

PATIENCE_S = 60.0


class Ear:
    """Remembers what a worker tells."""

    def __init__(self) -> None:
        self.heard: list[tuple[int, News]] = []
        self._changed = Condition()

    def hear(self, number: int, news: News) -> None:
        with self._changed:
            self.heard.append((number, news))
            self._changed.notify_all()

    def wait(self, wanted: Callable[[int, News], bool]) -> News:
        """The first news that is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: any(wanted(*one) for one in self.heard), PATIENCE_S)
            return next(news for number, news in self.heard if wanted(number, news))


@pytest.fixture
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.close()


@pytest.fixture
def ear(worker: Worker) -> Ear:
    ear = Ear()
    worker.listen(ear.hear)
    return ear


def test_a_recording_is_read_while_the_studio_goes_on(worker: Worker, ear: Ear) -> None:
    number = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=20.0), default_model()))
    ready = ear.wait(lambda told, news: told == number and isinstance(news, Ready))
    assert isinstance(ready, Ready) and ready.recorded.duration_s == pytest.approx(20.0, abs=0.1)
    assert ready.answer['seed'] == 1
    kinds = [type(news) for _, news in ear.heard]
    assert kinds.index(Contents) < kinds.index(Ready) and kinds.count(Advance) > 10


@pytest.mark.slow
def test_a_cancelled_task_stops_and_the_next_one_runs(worker: Worker, ear: Ear) -> None:
    long = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=600.0), default_model()))
    ear.wait(lambda told, news: told == long and isinstance(news, Advance))
    worker.cancel()
    assert isinstance(ear.wait(lambda told, news: told == long and isinstance(news, Stopped)), Stopped)
    number = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=10.0), default_model()))
    assert isinstance(ear.wait(lambda told, news: told == number and isinstance(news, Ready)), Ready)


def test_what_cannot_be_done_is_told_in_one_line(worker: Worker, ear: Ear, tmp_path: Path) -> None:
    worker.submit(OpenRecording(Bag(tmp_path / 'nothing', Config()), default_model()))
    failed = ear.wait(lambda _, news: isinstance(news, Failed))
    assert isinstance(failed, Failed) and 'no such bag' in failed.why and '\n' not in failed.why


def test_the_end_of_the_process_is_noticed(worker: Worker, ear: Ear) -> None:
    os.kill(worker.pid, signal.SIGKILL)
    failed = ear.wait(lambda _, news: isinstance(news, Failed))
    assert isinstance(failed, Failed) and 'has ended' in failed.why
    with pytest.raises(GyrocalError, match='start the studio again'):
        worker.submit(OpenRecording(HiddenEffectTask(1, Config()), default_model()))


def test_the_same_riddle_is_drawn_by_the_same_seed() -> None:
    first, second = (HiddenEffectTask(7, Config(), duration_s=10.0).source() for _ in range(2))
    assert first.hidden == second.hidden and first.truth.scale_factor == second.truth.scale_factor
    assert next(first.measurements()) == next(second.measurements())
