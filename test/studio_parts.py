"""For tests of the studio: a bag that hides an effect, and a worker that works when it is told to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.model_file import model_to_yaml
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sealed import answer_of, seal
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.studio.recordings import Bag
from gyrocal_ros.studio.session import Session
from gyrocal_ros.studio.worker import News, OpenRecording, Ready, Stopped, Task, _outcome, _Workbench

HIDDEN, SIZE = 'scale_asymmetry', 0.02


def write_bag(folder: Path) -> Path:
    """Many turns of a gyro whose scale depends on the side, the answer sealed beside it."""
    scenario = replace(find_scenario('demo'), duration_s=100.0, camera_hz=8)
    source = SimSource(scenario, 3, hidden=(HiddenEffect(find_effect(HIDDEN), (SIZE,)),))
    path = folder / 'uneven'
    with new_bag(path, 'mcap') as bag:
        bag.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
        for measurement in source.measurements():
            bag.write(measurement)
    seal(path, answer_of(source))
    return path


class Desk:
    """Does the work of a worker in this process, what was done before from memory."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self.ran: list[Task] = []
        self.told: list[News] = []
        self._queue: list[tuple[int, Task]] = []
        self._count = self._cancelled = 0

    def submit(self, task: Task) -> int:
        self._count += 1
        self._queue.append((self._count, task))
        return self._count

    def cancel(self) -> None:
        self._cancelled = self._count

    def work(self) -> None:
        """Do all that is queued."""
        assert self.session is not None
        while self._queue:
            number, task = self._queue.pop(0)
            if number <= self._cancelled:
                self.session.hear(number, Stopped())
                continue
            self.ran.append(task)
            news, outcome = _done(task)
            for one in (*news, outcome):
                self.told.append(one)
                self.session.hear(number, one)


_before_it: list[_Workbench] = []
_known: dict[str, tuple[list[News], News]] = {}


def _done(task: Task) -> tuple[list[News], News]:
    key = str(task.recording) if isinstance(task, OpenRecording) else model_to_yaml(task.model)
    if key not in _known:
        news: list[News] = []
        desk = _Workbench() if isinstance(task, OpenRecording) else _before_it[-1]
        _known[key] = news, _outcome(desk, task, news.append)
        if isinstance(_known[key][1], Ready):
            _before_it.append(desk)
    return _known[key]


def open_session(bag: Path, folder: Path, work: bool = True) -> tuple[Session, Desk]:
    """A session on a bag, the first model run where there is to be work."""
    desk = Desk()
    session = desk.session = Session(Bag(bag, Config()), default_model(), folder, desk)
    if work:
        desk.work()
    return session, desk
