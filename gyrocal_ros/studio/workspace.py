"""What one studio serves: the recordings that it was given, and the session that is open."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from pathlib import Path
from threading import RLock
from typing import Protocol

from gyrocal_ros.config.sections import Config
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask
from gyrocal_ros.studio.session import Session, Works
from gyrocal_ros.studio.state import StudioState
from gyrocal_ros.studio.worker import Listener, News

SEEDS = 10_000
"""Riddles are drawn from so many."""


class Helper(Works, Protocol):
    """Does the long work, and tells of it."""

    def listen(self, listener: Listener) -> None: ...

    def close(self) -> None: ...


class Workspace:
    """The recordings by number, so that a browser can name none that was not given."""

    def __init__(
        self,
        bags: Sequence[Bag],
        model: SensorModel,
        config: Config,
        out: Path,
        worker: Helper,
        riddle: int | None = None,
    ) -> None:
        """Open the first recording, or a riddle.

        Args:
            bags: that may be opened.
            model: to begin with.
            config: settings for riddles.
            out: a folder for the folders of the sessions.
            worker: does the long work.
            riddle: seed of the riddle to begin with; None to begin with the first recording.

        Raises:
            GyrocalError: another studio works in the folder.
        """
        self._bags, self._model, self._config, self._out = tuple(bags), model, config, out
        self._worker = worker
        self._lock = RLock()
        self._session = self._opened(self._bags[0] if riddle is None else self._riddle(riddle))
        worker.listen(self._hear)

    @property
    def titles(self) -> list[str]:
        """Of the recordings that may be opened."""
        return [bag.title for bag in self._bags]

    @property
    def session(self) -> Session:
        """The one that is open."""
        return self._session

    @property
    def view(self) -> StudioState:
        """The state of the open session."""
        return self._session.view

    def choose(self, number: int) -> None:
        """Open another recording.

        Raises:
            GyrocalError: there is no such recording, or another studio works on it.
        """
        if not 0 <= number < len(self._bags):
            raise GyrocalError('there is no such recording', where=str(number))
        self._change(self._bags[number])

    def draw_riddle(self, seed: int | None = None) -> None:
        """Open a recording that hides something, and that nobody has seen.

        Args:
            seed: of all draws; None to draw that too.

        Raises:
            GyrocalError: another studio works on it.
        """
        self._change(self._riddle(seed))

    def close(self) -> None:
        """End all work."""
        self._worker.cancel()
        self._session.close()
        self._worker.close()

    def _riddle(self, seed: int | None = None) -> HiddenEffectTask:
        return HiddenEffectTask(secrets.randbelow(SEEDS) if seed is None else seed, self._config)

    def _change(self, recording: Bag | HiddenEffectTask) -> None:
        with self._lock:
            if recording.title != self._session.view.title:
                self._worker.cancel()
                opened = self._opened(recording)  # where this fails, the other one stays
                self._session.close()
                self._session = opened

    def _opened(self, recording: Bag | HiddenEffectTask) -> Session:
        return Session(recording, self._model, self._out / recording.title, self._worker)

    def _hear(self, number: int, news: News) -> None:
        self._session.hear(number, news)
