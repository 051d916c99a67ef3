"""For tests of the studio: a bag with a hidden effect, and a worker in the process of the test."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import DrawnEffect, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sealed import answer_of, seal
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.studio.executor import TaskExecutor
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.tasks import OpenRecording, Ready, Stopped, Task, TaskMessage, ValidateModels

HIDDEN, SIZE = 'scale_asymmetry', 0.02


def write_bag(folder: Path) -> Path:
    """Write a bag with many turns of a gyro with a scale asymmetry, and the sealed answer beside it."""
    return _written(folder / 'uneven', HiddenEffect(find_effect(HIDDEN), (SIZE,)))


def write_strange_bag(folder: Path) -> Path:
    """Write a bag of a gyro whose bias follows the heading, which no effect of the library describes."""
    (law,) = hide([DrawnEffect('stranger_heading', (math.radians(0.5), 0.7))], find_effect)
    return _written(folder / 'strange', law)


def write_image_bag(folder: Path) -> Path:
    """Write a bag like that of `write_bag`, with images in place of features."""
    hidden = HiddenEffect(find_effect(HIDDEN), (SIZE,))
    return _written(folder / 'pictures', hidden, images=True, camera_hz=1)


def _written(path: Path, hidden: HiddenEffect, *, images: bool = False, camera_hz: int = 4) -> Path:
    scenario = replace(find_scenario('demo'), duration_s=100.0, imu_hz=100, camera_hz=camera_hz)
    source = SimSource(scenario, 3, images=images, hidden=(hidden,))
    with new_bag(path, 'mcap') as bag:
        bag.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
        for measurement in source.measurements():
            bag.write(measurement)
    seal(path, answer_of(source))
    return path


class IdleWorker:
    """Accepts tasks and executes none."""

    def __init__(self) -> None:
        self.tasks: list[Task] = []
        self.cancelled = self.closed = 0

    def listen(self, listener: Callable[[int, TaskMessage], None]) -> None:
        self.send = listener

    def submit(self, task: Task) -> int:
        self.tasks.append(task)
        return len(self.tasks)

    def cancel(self) -> None:
        self.cancelled += 1

    def close(self) -> None:
        self.closed += 1


class InProcessWorker:
    """Executes tasks in this process when `work` is called; repeated tasks return the stored messages."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self.executed: list[Task] = []
        self.sent: list[TaskMessage] = []
        self._queue: list[tuple[int, Task]] = []
        self._count = self._cancelled = 0
        self._recording = ''

    def submit(self, task: Task) -> int:
        self._count += 1
        self._queue.append((self._count, task))
        return self._count

    def cancel(self) -> None:
        self._cancelled = self._count

    def work(self) -> None:
        """Execute all queued tasks."""
        assert self.session is not None
        while self._queue:
            number, task = self._queue.pop(0)
            if number <= self._cancelled:
                self.session.receive(number, Stopped())
                continue
            self.executed.append(task)
            if isinstance(task, OpenRecording):
                self._recording = str(task.recording)
            messages, result = _messages(self._recording, task)
            for message in (*messages, result):
                self.sent.append(message)
                self.session.receive(number, message)


_executors: dict[str, TaskExecutor] = {}
_stored: dict[str, tuple[list[TaskMessage], TaskMessage]] = {}


def _messages(recording: str, task: Task) -> tuple[list[TaskMessage], TaskMessage]:
    subject = str(task) if isinstance(task, OpenRecording | ValidateModels) else model_to_yaml(task.model)
    key = f'{recording} {type(task).__name__} {subject}'
    if key not in _stored:
        messages: list[TaskMessage] = []
        executor = TaskExecutor() if isinstance(task, OpenRecording) else _executors[recording]
        _stored[key] = messages, executor.execute(task, messages.append)
        if isinstance(_stored[key][1], Ready):
            _executors[recording] = executor
    return _stored[key]


def open_session(bag: Path, folder: Path, work: bool = True) -> tuple[Session, InProcessWorker]:
    """Open a session on a bag, and run the first model unless `work` is False."""
    worker = InProcessWorker()
    session = worker.session = Session(Bag(bag, Config()), default_model(), folder, worker)
    if work:
        worker.work()
    return session, worker
