"""Execution of tasks: the recording stays in memory, and the filter runs over it."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from itertools import count

import numpy as np

from gyrocal_ros.diagnose.analysis.drift import reference_heading
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine
from gyrocal_ros.diagnose.analysis.heading_filter import headings
from gyrocal_ros.diagnose.analysis.ranking import best_explanation
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.analysis.shapes import shapes
from gyrocal_ros.diagnose.analysis.validation import validate
from gyrocal_ros.diagnose.analysis.wander import wander
from gyrocal_ros.diagnose.diagnosis import diagnose_before_adding
from gyrocal_ros.diagnose.laws.learning import is_missing_something, learn
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.limit_runs import limits_to_check
from gyrocal_ros.diagnose.search.recovery import first_run
from gyrocal_ros.diagnose.series.error_curves import centred
from gyrocal_ros.diagnose.series.run_series import rows_to_draw
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.run_filter import Progress
from gyrocal_ros.studio.recordings import LoadedRecording, inspect_recording, load_recording
from gyrocal_ros.studio.tasks import (
    Examination,
    Examine,
    Failed,
    LearnedResult,
    LearnLaw,
    OpenRecording,
    Ready,
    RunPreview,
    Stopped,
    Task,
    TaskMessage,
    TaskProgress,
    ValidateModels,
    ValidationResult,
)

Send = Callable[[TaskMessage], None]
"""Sends a message about the task that is running; raises `Cancelled` if that is cancelled."""
MAX_KEPT = 4
"""Number of examined models that are kept, to learn from one without another run."""
PREVIEW_PERIOD_S = 0.8
"""Minimum time between two previews of a running filter."""
PREVIEW_POINTS = 600
"""Maximum number of points of the rate in a preview."""
MIN_PREVIEW_HEADINGS = 50
"""Minimum number of observed headings for a preview."""
MIN_PREVIEW_S = 15.0
"""Minimum recorded time for a preview."""


class Cancelled(Exception):
    """The task was cancelled."""


class TaskExecutor:
    """Executes tasks; keeps the open recording between them."""

    def __init__(self) -> None:
        self._loaded: LoadedRecording | None = None
        self._examined: list[ExaminedModel] = []

    def execute(self, task: Task, send: Send) -> TaskMessage:
        """Execute a task; return its result, or the reason why it failed."""
        try:
            send(TaskProgress(0.0, 'starting'))
            if isinstance(task, OpenRecording):
                return self._open(task, send)
            if isinstance(task, ValidateModels):
                return _validate(task, send)
            return self._learn(task, send) if isinstance(task, LearnLaw) else self._examine(task, send)
        except Cancelled:
            return Stopped()
        except GyrocalError as error:
            return Failed(str(error))
        except MemoryError:
            return Failed('this machine has too little memory')
        except Exception as error:  # one recording must not end the work on all others
            traceback.print_exc()
            return Failed(f'internal error ({error!r}); please report it with the recording')

    def _open(self, task: OpenRecording, send: Send) -> Ready:
        self._loaded, self._examined = None, []
        send(TaskProgress(0.0, 'checking the recording'))
        contents = inspect_recording(task.recording)
        send(contents)
        self._loaded = load_recording(task.recording, contents, task.model, _reporter(send, 'reading'))
        return Ready(self._loaded.recorded, self._loaded.answer)

    def _examine(self, task: Examine, send: Send) -> Examination:
        assert self._loaded is not None
        loaded, run = self._loaded, _runs_with_preview(self._loaded, send)
        if task.is_first:
            examined, _ = first_run(task.model, loaded.recorded, run)
        else:
            examined = examine(task.model, loaded.recorded, run)
        self._examined = [*self._examined, examined][-MAX_KEPT:]
        return _examination(examined, loaded.recorded)

    def _learn(self, task: LearnLaw, send: Send) -> LearnedResult:
        """Learn one law, as `gyrocal learn` does."""
        assert self._loaded is not None
        recorded, run = self._loaded.recorded, _numbered_runs(self._loaded, send)
        present = next((one for one in self._examined if one.model == task.model), None)
        if present is None:
            present = examine(task.model, recorded, run)
        searched = learn(Search(present, ()), recorded, run, most=1).searched
        if not searched.kept:
            return LearnedResult(None)
        (kept,) = searched.kept
        first = next(item for item in searched.additions if item.effect.name == kept.effect.name)
        found, curve = _examination(kept.after, recorded), _examination(first.after, recorded)
        return LearnedResult(found, curve, first.gain, first.sigma)


def _runs_with_preview(loaded: LoadedRecording, send: Send) -> Calibrate:
    """Return a function that runs the filter and sends previews of the run."""
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

    return run


def _numbered_runs(loaded: LoadedRecording, send: Send) -> Calibrate:
    """Return a function that runs the filter and says which run of the learning it is."""
    numbers = count(1)

    def run(model: SensorModel, candidates: tuple[Effect, ...]) -> Run:
        report = _reporter(send, f'learning, run {next(numbers)}')
        return calibrate(loaded.source, loaded.config, model, report=report, candidates=candidates)

    return run


def _validate(task: ValidateModels, send: Send) -> ValidationResult:
    """Run trained models over another recording, which is in memory for as long as this takes."""
    title, present = task.recording.title, list(task.trained.values())[-1]
    contents = inspect_recording(task.recording)
    loaded = load_recording(task.recording, contents, present.model, _reporter(send, f'reading {title}'))
    runs = {
        label: calibrate(
            loaded.source, loaded.config, known.model, report=_reporter(send, f'running {label} on {title}')
        )
        for label, known in task.trained.items()
    }
    reference = reference_heading(list(runs.values())[-1])
    found = {label: validate(task.trained[label], run, reference) for label, run in runs.items()}
    return ValidationResult(title, found)


def _reporter(send: Send, text: str) -> Callable[[Progress], None]:
    """Return a function that sends the progress of one step."""

    def report(progress: Progress) -> None:
        send(TaskProgress(progress.done_s / max(progress.total_s, 1.0), text))

    return report


def _examination(examined: ExaminedModel, recorded: RecordingSummary) -> Examination:
    best = best_explanation(examined.ranked, examined.scores, (), examined.settings)
    limits = tuple(limit.effect for limit in limits_to_check(examined, recorded, best))
    names = [limit.name for limit in limits]
    return Examination(
        examined=examined,
        best=best,
        limits=limits,
        diagnosis=diagnose_before_adding(examined, best, names, recorded),
        wander=wander(examined.seen),
        error_curves={
            (item.signal, item.of_scale): centred(item) for item in shapes(examined.run, examined.seen)
        },
        is_contradicted=is_missing_something(examined),
    )


def _preview(run: Run) -> RunPreview | None:
    history = run.history
    count = np.isfinite(history.heading_innovation_rad).sum()
    if not len(history.time_s) or history.time_s[-1] < MIN_PREVIEW_S or count < MIN_PREVIEW_HEADINGS:
        return None
    rate_deg_s = np.degrees(history.turn_rad / history.dt_s)
    rows = rows_to_draw(rate_deg_s[:, None], PREVIEW_POINTS)
    return RunPreview(wander(headings(run)), history.time_s[rows], rate_deg_s[rows])
