"""Long work in a process of its own, so that the page answers at once and a task can be cancelled.

A studio has one such process. It keeps the recording in memory and runs the filter over it, one task after
the other. Tasks arrive over a pipe; progress and results go back over the same pipe. The process ends with
the studio.
"""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Lock, Thread
from typing import Any, TypeAlias

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.additions import NONE
from gyrocal_ros.diagnose.error_curves import ErrorCurve, centred
from gyrocal_ros.diagnose.examined import ExaminedModel, examine
from gyrocal_ros.diagnose.heading_filter import headings
from gyrocal_ros.diagnose.model_fit import ModelFit, model_fit
from gyrocal_ros.diagnose.ranking import RankedEffect, best_explanation, indistinguishable
from gyrocal_ros.diagnose.regimes import Failure, failures
from gyrocal_ros.diagnose.run_series import rows_to_draw
from gyrocal_ros.diagnose.search import limits_to_check, recover
from gyrocal_ros.diagnose.shapes import shapes
from gyrocal_ros.diagnose.wander import Wander, wander
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.errors import FilterDivergedError, GyrocalError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.studio.recordings import (
    Bag,
    HiddenEffectTask,
    LoadedRecording,
    RecordingContents,
    inspect_recording,
    load_recording,
)

PREVIEW_PERIOD_S = 0.8
"""Minimum time between two previews of a running filter."""
PREVIEW_POINTS = 600
"""Maximum number of points of the rate in a preview."""
MIN_PREVIEW_HEADINGS = 50
"""Minimum number of observed headings for a preview."""
MIN_PREVIEW_S = 15.0
"""Minimum recorded time for a preview."""


@dataclass(frozen=True, slots=True)
class OpenRecording:
    """Task: inspect a recording, and load it."""

    recording: Bag | HiddenEffectTask
    model: SensorModel


@dataclass(frozen=True, slots=True)
class Examine:
    """Task: run a model over the recording, with all other effects as candidates."""

    model: SensorModel
    is_first: bool = False
    """If the filter diverges with this model, look for an effect with which it does not."""


Task: TypeAlias = OpenRecording | Examine


@dataclass(frozen=True, slots=True)
class TaskProgress:
    """Progress of a task."""

    fraction: float
    """0 to 1."""
    text: str
    """Description of the present step."""


@dataclass(frozen=True, slots=True, eq=False)
class RunPreview:
    """The heading error of a running filter up to now."""

    wander: Wander
    time_s: Array
    rate_deg_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """A model on the recording, with everything about it that takes long to compute."""

    examined: ExaminedModel
    best: RankedEffect | None
    """The effect that explains most of the remaining error; None if that is no more than chance."""
    limits: tuple[Effect, ...]
    """Limits that the readings suggest; only a run can score them."""
    indistinguishable: tuple[str, ...]
    """Effects that this recording cannot distinguish from the best."""
    failures: tuple[Failure, ...]
    fit: ModelFit
    wander: Wander
    error_curves: Mapping[tuple[str, bool], ErrorCurve]
    """Remaining error of the bias (False) or the scale (True) by signal, the most significant first."""


@dataclass(frozen=True, slots=True)
class Ready:
    """Result: a recording that was loaded."""

    recorded: RecordingSummary
    answer: Any


@dataclass(frozen=True, slots=True)
class Failed:
    """Result: the reason why a task failed."""

    why: str


@dataclass(frozen=True, slots=True)
class Stopped:
    """Result: the task was cancelled."""


TaskMessage: TypeAlias = (
    TaskProgress | RecordingContents | Ready | RunPreview | Examination | Failed | Stopped
)
Listener: TypeAlias = Callable[[int, TaskMessage], None]
"""Called with the number of a task and a message about it."""


ENDED, RESTART = 'the worker process has ended', 'start the studio again, nothing is lost'


class Worker:
    """The worker process, as seen from the studio. It forks: make it before any thread is started."""

    def __init__(self) -> None:
        context = get_context('fork')
        self._pipe, other_end = context.Pipe()
        self._cancelled = context.Value('l', 0)
        self._process = context.Process(
            target=_run_tasks,
            args=(other_end, self._pipe, self._cancelled),
            name='gyrocal studio',
            daemon=True,
        )
        self._process.start()
        other_end.close()
        self._lock, self._count = Lock(), 0

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid or 0

    def listen(self, listener: Listener) -> None:
        """Pass all messages to a listener, in a thread of its own."""
        Thread(target=self._listen, args=(listener,), name='worker messages', daemon=True).start()

    def submit(self, task: Task) -> int:
        """Queue a task; return its number, which is larger than all earlier ones.

        Raises:
            GyrocalError: the process has ended.
        """
        with self._lock:
            self._count += 1
            try:
                self._pipe.send((self._count, task))
            except OSError as error:
                raise GyrocalError(ENDED, todo=RESTART) from error
            return self._count

    def cancel(self) -> None:
        """Stop all tasks that have been submitted."""
        self._cancelled.value = self._count

    def close(self) -> None:
        """End the process."""
        self.cancel()
        self._process.terminate()
        self._process.join(2.0)

    def _listen(self, listener: Listener) -> None:
        try:
            while True:
                listener(*self._pipe.recv())
        except (EOFError, OSError):
            listener(self._count, Failed(f'{ENDED}; {RESTART}'))


class _Cancelled(Exception):
    """The task was cancelled."""


def _run_tasks(pipe: Connection, other_end: Connection, cancelled: Any) -> None:
    """Execute tasks until the studio closes the pipe."""
    other_end.close()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the studio decides when to end
    executor = _TaskExecutor()
    with suppress(EOFError, OSError):
        while True:
            number, task = pipe.recv()

            def send(message: TaskMessage, number: int = number) -> None:
                if cancelled.value >= number:
                    raise _Cancelled
                pipe.send((number, message))

            pipe.send((number, _execute(executor, task, send)))


def _execute(executor: _TaskExecutor, task: Task, send: Callable[[TaskMessage], None]) -> TaskMessage:
    try:
        send(TaskProgress(0.0, 'starting'))
        return executor.open(task, send) if isinstance(task, OpenRecording) else executor.examine(task, send)
    except _Cancelled:
        return Stopped()
    except GyrocalError as error:
        return Failed(str(error))
    except MemoryError:
        return Failed('this machine has too little memory')
    except Exception as error:  # one recording must not end the work on all others
        traceback.print_exc()
        return Failed(f'internal error ({error!r}); please report it with the recording')


class _TaskExecutor:
    """Executes tasks; keeps the open recording between them."""

    def __init__(self) -> None:
        self._loaded: LoadedRecording | None = None

    def open(self, task: OpenRecording, send: Callable[[TaskMessage], None]) -> Ready:
        self._loaded = None
        send(TaskProgress(0.0, 'checking the recording'))
        contents = inspect_recording(task.recording)
        send(contents)

        def report(progress: Progress) -> None:
            send(TaskProgress(progress.done_s / max(progress.total_s, 1.0), 'reading'))

        self._loaded = load_recording(task.recording, contents, task.model, report)
        return Ready(self._loaded.recorded, self._loaded.answer)

    def examine(self, task: Examine, send: Callable[[TaskMessage], None]) -> Examination:
        assert self._loaded is not None
        loaded = self._loaded
        preview_sent_s = 0.0

        def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
            text = f'running with {", ".join(effect.name for effect in model.effects)}'

            def report(progress: Progress) -> None:
                nonlocal preview_sent_s
                send(TaskProgress(progress.done_s / max(progress.total_s, 1.0), text))
                if progress.so_far is not None and time.monotonic() - preview_sent_s > PREVIEW_PERIOD_S:
                    preview = _preview(progress.so_far())
                    if preview is not None:
                        send(preview)
                        preview_sent_s = time.monotonic()

            return calibrate(loaded.source, loaded.config, model, report=report, candidates=candidates)

        try:
            examined = examine(task.model, loaded.recorded, run)
        except FilterDivergedError:
            change = recover(task.model, loaded.recorded, run) if task.is_first else None
            if change is None:
                raise
            examined = change.after
        return _examination(examined, loaded.recorded)


def _examination(examined: ExaminedModel, recorded: RecordingSummary) -> Examination:
    best = best_explanation(examined.ranked, examined.scores, (), examined.settings)
    others = [ranked for ranked in examined.ranked if ranked is not best]
    return Examination(
        examined=examined,
        best=best,
        limits=tuple(limit.effect for limit in limits_to_check(examined, recorded, best)),
        indistinguishable=()
        if best is None
        else tuple(indistinguishable(best, others, examined.scores, NONE, examined.settings)),
        failures=tuple(failures(examined.run, examined.seen)),
        fit=model_fit(examined.run),
        wander=wander(examined.seen),
        error_curves={
            (item.signal, item.of_scale): centred(item) for item in shapes(examined.run, examined.seen)
        },
    )


def _preview(run: Run) -> RunPreview | None:
    history = run.history
    count = np.isfinite(history.heading_innovation_rad).sum()
    if not len(history.time_s) or history.time_s[-1] < MIN_PREVIEW_S or count < MIN_PREVIEW_HEADINGS:
        return None
    rate_deg_s = np.degrees(history.turn_rad / history.dt_s)
    rows = rows_to_draw(rate_deg_s[:, None], PREVIEW_POINTS)
    return RunPreview(wander(headings(run)), history.time_s[rows], rate_deg_s[rows])
