"""The recordings of one studio, and the session that is open."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from threading import RLock
from typing import Protocol

from gyrocal_ros.bag.check import check_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.msgs.issues import raise_first_error
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask
from gyrocal_ros.studio.session import Session, TaskRunner
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.tasks import Listener, TaskMessage

SEEDS = 10_000
"""Number of seeds from which hidden-effect tasks are drawn."""


class TaskProcess(TaskRunner, Protocol):
    """Does long work in another process, and sends messages about it."""

    def listen(self, listener: Listener) -> None: ...

    def close(self) -> None: ...


class Workspace:
    """The recordings, which a browser can choose by number only, and the open session."""

    def __init__(
        self,
        bags: Sequence[Bag],
        model: SensorModel,
        config: Config,
        out: Path,
        worker: TaskProcess,
        task_seed: int | None = None,
    ) -> None:
        """Open the first recording, or a hidden-effect task.

        Args:
            bags: recordings that may be opened.
            model: first model of each session.
            config: settings for hidden-effect tasks.
            out: folder of the folders of the sessions.
            worker: does the long work.
            task_seed: seed of the hidden-effect task to open; None for the first recording.

        Raises:
            GyrocalError: another studio uses the folder.
        """
        self.out = out
        """Folder of the folders of the sessions."""
        self._bags, self._model, self._config = tuple(bags), model, config
        self._worker = worker
        self._lock = RLock()
        self._session = self._open(self._bags[0] if task_seed is None else self._task(task_seed))
        worker.listen(self._receive)

    @property
    def titles(self) -> list[str]:
        """Titles of the recordings that may be opened."""
        return [bag.title for bag in self._bags]

    @property
    def session(self) -> Session:
        """The open session."""
        return self._session

    @property
    def state(self) -> StudioState:
        """State of the open session."""
        return self._session.state

    def choose(self, number: int) -> None:
        """Open another recording.

        Raises:
            GyrocalError: there is no such recording, or another studio uses its folder.
        """
        self._change(self._bag(number))

    def require_usable(self, path: Path) -> None:
        """Check a recording that is not among those of the workspace.

        Raises:
            GyrocalError: it cannot be used for a calibration.
        """
        bag = self._bag_at(path)
        raise_first_error(check_bag(path, bag.config, **bag.options).issues, path.name)

    def open_new(self, path: Path) -> None:
        """Add a recording, and open it.

        Raises:
            GyrocalError: another studio uses its folder.
        """
        bag = self._bag_at(path)
        with self._lock:
            self._bags = (*self._bags, bag)
        self._change(bag)

    def validate_on(self, number: int) -> None:
        """Test the models of the open session on another recording.

        Raises:
            GyrocalError: there is no such recording, or no model to test on it.
        """
        self._session.validate_on(self._bag(number))

    def draw_task(self, seed: int | None = None) -> None:
        """Open a simulated recording with hidden effects.

        Args:
            seed: seed of all random numbers; None for a random one.

        Raises:
            GyrocalError: another studio uses its folder.
        """
        self._change(self._task(seed))

    def close(self) -> None:
        """End all work."""
        self._worker.cancel()
        self._session.close()
        self._worker.close()

    def _bag(self, number: int) -> Bag:
        if not 0 <= number < len(self._bags):
            raise GyrocalError('there is no such recording', where=str(number))
        return self._bags[number]

    def _bag_at(self, path: Path) -> Bag:
        """Return a recording that is read with the options of the others."""
        return replace(self._bags[0], path=path, name='')

    def _task(self, seed: int | None = None) -> HiddenEffectTask:
        return HiddenEffectTask(secrets.randbelow(SEEDS) if seed is None else seed, self._config)

    def _change(self, recording: Bag | HiddenEffectTask) -> None:
        with self._lock:
            if recording.title != self._session.state.title:
                self._worker.cancel()
                session = self._open(recording)  # if this fails, the old session stays open
                self._session.close()
                self._session = session

    def _open(self, recording: Bag | HiddenEffectTask) -> Session:
        return Session(recording, self._model, self.out / recording.title, self._worker)

    def _receive(self, number: int, message: TaskMessage) -> None:
        self._session.receive(number, message)
