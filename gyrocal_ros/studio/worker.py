"""The long work, in a process of its own, so that the page answers at once and a cancel is heeded.

One process serves one studio: it keeps the recording in memory and runs the filter over it, one task
after the other. What it needs to know it is told over a pipe; how far it is and what came of it it
tells back. It dies with the studio.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Lock, Thread
from typing import Any, TypeAlias

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.error_curves import ErrorCurve, centred
from gyrocal_ros.diagnose.heading_filter import headings
from gyrocal_ros.diagnose.ranking import RankedEffect, best_explanation, indistinguishable
from gyrocal_ros.diagnose.regimes import Failure, failures
from gyrocal_ros.diagnose.run_series import rows_to_draw
from gyrocal_ros.diagnose.search import NONE, ExaminedModel, examine, recover, suspected_limits
from gyrocal_ros.diagnose.shapes import shapes
from gyrocal_ros.diagnose.wander import Wander, wander
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.errors import FilterDivergedError, GyrocalError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.studio.recordings import Bag, Contents, HiddenEffectTask, Opened, look_into, read

GLIMPSE_S = 0.8
"""How often a run that is under way shows itself."""
GLIMPSE_POINTS = 600
FEWEST_SEEN = 50
SHORTEST_S = 15.0
"""A run that has come less far shows nothing yet."""


@dataclass(frozen=True, slots=True)
class OpenRecording:
    """See what is in a recording, and read it."""

    recording: Bag | HiddenEffectTask
    model: SensorModel


@dataclass(frozen=True, slots=True)
class Examine:
    """Run a model over the recording, everything else on trial."""

    model: SensorModel
    is_first: bool = False
    """Where the filter cannot run with it, look for an effect with which it can."""


Task: TypeAlias = OpenRecording | Examine


@dataclass(frozen=True, slots=True)
class Advance:
    """How far a task has come, 0 to 1."""

    part: float
    doing: str


@dataclass(frozen=True, slots=True, eq=False)
class RunPreview:
    """The heading so far, as far as a run that is under way can tell."""

    wander: Wander
    time_s: Array
    rate_deg_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    """A model on the recording, with all that takes a while to tell of it."""

    stage: ExaminedModel
    best: RankedEffect | None
    """The effect that explains most of what is left over; None where that is no more than chance."""
    limits: tuple[Effect, ...]
    """Limits that the readings suggest; only a run can tell what they explain."""
    twins: tuple[str, ...]
    """Effects that may be meant in place of the best."""
    failures: tuple[Failure, ...]
    wander: Wander
    left_over: Mapping[tuple[str, bool], ErrorCurve]
    """By signal, and whether of the scale: what is left over, the most telling first."""


@dataclass(frozen=True, slots=True)
class Ready:
    """A recording that was read."""

    recorded: RecordingSummary
    answer: Any


@dataclass(frozen=True, slots=True)
class Failed:
    """A task that cannot be done, and why."""

    why: str


@dataclass(frozen=True, slots=True)
class Stopped:
    """A task that was cancelled."""


News: TypeAlias = Advance | Contents | Ready | RunPreview | Examined | Failed | Stopped
Listener: TypeAlias = Callable[[int, News], None]
"""Told the number of a task, and news of it."""


ENDED, AGAIN = 'the process that does the work has ended', 'start the studio again, nothing is lost'


class Worker:
    """The process, seen from the studio. Make it before the studio has threads."""

    def __init__(self) -> None:
        context = get_context('fork')
        self._pipe, theirs = context.Pipe()
        self._cancelled = context.Value('l', 0)
        self._process = context.Process(
            target=_serve, args=(theirs, self._pipe, self._cancelled), name='gyrocal studio', daemon=True
        )
        self._process.start()
        theirs.close()
        self._lock, self._count = Lock(), 0

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid or 0

    def listen(self, listener: Listener) -> None:
        """Have a listener told all news, in a thread of its own."""
        Thread(target=self._hear, args=(listener,), name='news', daemon=True).start()

    def submit(self, task: Task) -> int:
        """Queue a task; returns its number, larger than all before.

        Raises:
            GyrocalError: the process has ended.
        """
        with self._lock:
            self._count += 1
            try:
                self._pipe.send((self._count, task))
            except OSError as error:
                raise GyrocalError(ENDED, todo=AGAIN) from error
            return self._count

    def cancel(self) -> None:
        """Stop all tasks so far."""
        self._cancelled.value = self._count

    def close(self) -> None:
        """End the process."""
        self.cancel()
        self._process.terminate()
        self._process.join(2.0)

    def _hear(self, listener: Listener) -> None:
        try:
            while True:
                listener(*self._pipe.recv())
        except (EOFError, OSError):
            listener(self._count, Failed(f'{ENDED}; {AGAIN}'))


class _Cancelled(Exception):
    """The task is not wanted any more."""


def _serve(pipe: Connection, other_end: Connection, cancelled: Any) -> None:
    """Do tasks until the studio hangs up."""
    other_end.close()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the studio decides when to end
    desk = _Workbench()
    with suppress(EOFError, OSError):
        while True:
            number, task = pipe.recv()

            def tell(news: News, number: int = number) -> None:
                if cancelled.value >= number:
                    raise _Cancelled
                pipe.send((number, news))

            pipe.send((number, _outcome(desk, task, tell)))


def _outcome(desk: _Workbench, task: Task, tell: Callable[[News], None]) -> News:
    try:
        tell(Advance(0.0, 'beginning'))
        return desk.look(task, tell) if isinstance(task, OpenRecording) else desk.examine(task, tell)
    except _Cancelled:
        return Stopped()
    except GyrocalError as error:
        return Failed(str(error))
    except MemoryError:
        return Failed('the memory of this machine does not suffice')


class _Workbench:
    """What the process has before it."""

    def __init__(self) -> None:
        self._opened: Opened | None = None

    def look(self, task: OpenRecording, tell: Callable[[News], None]) -> Ready:
        self._opened = None
        tell(Advance(0.0, 'looking into the recording'))
        contents = look_into(task.recording)
        tell(contents)

        def report(state: Progress) -> None:
            tell(Advance(state.done_s / max(state.total_s, 1.0), 'reading'))

        self._opened = read(task.recording, contents, task.model, report)
        return Ready(self._opened.recorded, self._opened.answer)

    def examine(self, task: Examine, tell: Callable[[News], None]) -> Examined:
        assert self._opened is not None
        opened = self._opened
        reported_s = 0.0

        def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
            doing = f'running with {", ".join(effect.name for effect in model.effects)}'

            def report(state: Progress) -> None:
                nonlocal reported_s
                tell(Advance(state.done_s / max(state.total_s, 1.0), doing))
                if state.so_far is not None and time.monotonic() - reported_s > GLIMPSE_S:
                    glimpse = _glimpse(state.so_far())
                    if glimpse is not None:
                        tell(glimpse)
                        reported_s = time.monotonic()

            return calibrate(opened.source, opened.config, model, report=report, candidates=candidates)

        try:
            stage = examine(task.model, opened.recorded, run)
        except FilterDivergedError:
            change = recover(task.model, opened.recorded, run) if task.is_first else None
            if change is None:
                raise
            stage = change.after
        return _examined(stage, opened.recorded)


def _examined(stage: ExaminedModel, recorded: RecordingSummary) -> Examined:
    best = best_explanation(stage.ranked, stage.scores, (), stage.settings)
    others = [ranked_effect for ranked_effect in stage.ranked if ranked_effect is not best]
    return Examined(
        stage=stage,
        best=best,
        limits=tuple(limit.effect for limit in suspected_limits(stage, recorded, best)),
        twins=()
        if best is None
        else tuple(indistinguishable(best, others, stage.scores, NONE, stage.settings)),
        failures=tuple(failures(stage.run, stage.seen)),
        wander=wander(stage.seen),
        left_over={(item.signal, item.of_scale): centred(item) for item in shapes(stage.run, stage.seen)},
    )


def _glimpse(run: Run) -> RunPreview | None:
    history = run.history
    seen = np.isfinite(history.heading_innovation_rad).sum()
    if not len(history.time_s) or history.time_s[-1] < SHORTEST_S or seen < FEWEST_SEEN:
        return None
    rate_deg_s = np.degrees(history.turn_rad / history.dt_s)
    rows = rows_to_draw(rate_deg_s[:, None], GLIMPSE_POINTS)
    return RunPreview(wander(headings(run)), history.time_s[rows], rate_deg_s[rows])
