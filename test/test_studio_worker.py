"""The worker process: messages, cancellation, and detection of its end."""

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
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask, RecordingContents
from gyrocal_ros.studio.tasks import Failed, OpenRecording, Ready, Stopped, TaskMessage, TaskProgress
from gyrocal_ros.studio.worker import Worker

TIMEOUT_S = 60.0


class Recorder:
    """Stores the messages of a worker."""

    def __init__(self) -> None:
        self.received: list[tuple[int, TaskMessage]] = []
        self._changed = Condition()

    def receive(self, number: int, message: TaskMessage) -> None:
        with self._changed:
            self.received.append((number, message))
            self._changed.notify_all()

    def wait(self, matches: Callable[[int, TaskMessage], bool]) -> TaskMessage:
        """Return the first message that matches."""
        with self._changed:
            self._changed.wait_for(lambda: any(matches(*one) for one in self.received), TIMEOUT_S)
            return next(message for number, message in self.received if matches(number, message))


@pytest.fixture
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.close()


@pytest.fixture
def recorder(worker: Worker) -> Recorder:
    recorder = Recorder()
    worker.listen(recorder.receive)
    return recorder


def test_a_recording_is_read_in_the_background(worker: Worker, recorder: Recorder) -> None:
    number = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=20.0), default_model()))
    ready = recorder.wait(lambda task, message: task == number and isinstance(message, Ready))
    assert isinstance(ready, Ready) and ready.recorded.duration_s == pytest.approx(20.0, abs=0.1)
    assert ready.answer['seed'] == 1
    kinds = [type(message) for _, message in recorder.received]
    assert kinds.index(RecordingContents) < kinds.index(Ready) and kinds.count(TaskProgress) > 10


@pytest.mark.slow
def test_a_cancelled_task_stops_and_the_next_one_runs(worker: Worker, recorder: Recorder) -> None:
    long = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=600.0), default_model()))
    recorder.wait(lambda task, message: task == long and isinstance(message, TaskProgress))
    worker.cancel()
    assert isinstance(
        recorder.wait(lambda task, message: task == long and isinstance(message, Stopped)), Stopped
    )
    number = worker.submit(OpenRecording(HiddenEffectTask(1, Config(), duration_s=10.0), default_model()))
    assert isinstance(
        recorder.wait(lambda task, message: task == number and isinstance(message, Ready)), Ready
    )


def test_a_failure_is_reported_in_one_line(worker: Worker, recorder: Recorder, tmp_path: Path) -> None:
    worker.submit(OpenRecording(Bag(tmp_path / 'nothing', Config()), default_model()))
    failed = recorder.wait(lambda _, message: isinstance(message, Failed))
    assert isinstance(failed, Failed) and 'no such bag' in failed.why and '\n' not in failed.why


def test_the_end_of_the_process_is_reported(worker: Worker, recorder: Recorder) -> None:
    os.kill(worker.pid, signal.SIGKILL)
    failed = recorder.wait(lambda _, message: isinstance(message, Failed))
    assert isinstance(failed, Failed) and 'has ended' in failed.why
    with pytest.raises(GyrocalError, match='start the studio again'):
        worker.submit(OpenRecording(HiddenEffectTask(1, Config()), default_model()))


def test_the_same_seed_draws_the_same_task() -> None:
    first, second = (HiddenEffectTask(7, Config(), duration_s=10.0).source() for _ in range(2))
    assert first.hidden == second.hidden and first.truth.scale_factor == second.truth.scale_factor
    assert next(first.measurements()) == next(second.measurements())
