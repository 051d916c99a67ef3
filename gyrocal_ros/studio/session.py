"""The actions of a user on one recording: a state machine without browser and without ROS.

Every action is a method that returns at once; long work goes to the worker. `state` is the state as an
immutable value. All results are written to the session's folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Condition
from typing import Any, Protocol

from gyrocal_ros.diagnose.analysis.examined import wider_model, with_effect
from gyrocal_ros.diagnose.search.improvement import Improvement
from gyrocal_ros.effects import EFFECTS, LEARNED_EFFECTS, find_effect
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.sealed import sealed_path, unseal
from gyrocal_ros.studio import store
from gyrocal_ros.studio.lesson import reveal
from gyrocal_ros.studio.recordings import Bag, HiddenEffectTask, RecordingContents, identity
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.state import TASK_TEXT, Proposal, RunningTask, StudioState
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

MAX_EARLIER_FORECASTS = 5
"""Maximum number of forecasts that are kept beside the latest; each takes some megabytes."""


class TaskRunner(Protocol):
    """Does long work."""

    def submit(self, task: Task) -> int: ...

    def cancel(self) -> None: ...


class Session:
    """Work on one recording. Thread-safe."""

    def __init__(
        self, recording: Bag | HiddenEffectTask, model: SensorModel, folder: Path, worker: TaskRunner
    ) -> None:
        """Start to read the recording.

        Args:
            recording: the recording.
            model: the first model, unless the folder contains an earlier session.
            folder: folder of the session, locked for other studios while this one is open.
            worker: does the long work; its messages go to `receive`.

        Raises:
            GyrocalError: another studio uses the folder.
        """
        self._recording, self._model, self._folder, self._worker = recording, model, folder, worker
        self._changed = Condition()
        self._answer: Mapping[str, Any] | None = None
        self._lock = ExitStack()
        self._lock.enter_context(store.locked(folder))
        has_answer = isinstance(recording, HiddenEffectTask) or sealed_path(recording.path).is_file()
        self._state = StudioState(title=recording.title, has_answer=has_answer)
        with self._changed:
            self._start_task('open', recording.title, OpenRecording(recording, model))

    @property
    def state(self) -> StudioState:
        """The present state."""
        return self._state

    @property
    def folder(self) -> Path:
        """Folder of the results."""
        return self._folder

    def wait(self, condition: Callable[[StudioState], bool], timeout_s: float) -> StudioState:
        """Wait until the state satisfies a condition or the time is over; return the state."""
        with self._changed:
            self._changed.wait_for(lambda: condition(self._state), timeout_s)
            return self._state

    def close(self) -> None:
        """Release the folder; later messages of the worker are ignored."""
        with self._changed:
            self._state = replace(self._state, running=None)
            self._lock.close()

    # --- actions of the user ---------------------------------------------------------------------

    def add(self, effect: str) -> None:
        """Add an effect to the present model and fit it.

        Raises:
            GyrocalError: it cannot be added, or another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            state = self._state
            tried = state.tree.find_addition(effect)
            if tried is not None:
                self._set_present(tried.label, f'{effect} is in the model again.')
                return
            forecast = state.forecast(effect)
            if forecast is not None:
                self._add_examination(forecast)
                return
            model = self._model_with(effect)
            running = state.running
            if running is not None and (running.subject, running.parent) == (
                effect,
                state.tree.present_label,
            ):
                self._publish(running=replace(running, kind='add'), message='')  # its forecast is running
                return
            self._start_task('add', effect, Examine(model))

    def forecast(self, effect: str) -> None:
        """Run the present model with one more effect in advance, unless another task is running.

        Raises:
            GyrocalError: the effect cannot be added.
        """
        with self._changed:
            state, running = self._state, self._state.running
            is_running = running is not None and running.subject == effect
            if not state.is_busy and not is_running and state.forecast(effect) is None:
                self._start_task('forecast', effect, Examine(self._model_with(effect)))

    def learn(self) -> None:
        """Learn a law that no effect of the library has, from what the present model leaves unexplained.

        Raises:
            GyrocalError: the recording does not contradict the model, or another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            present = self._state.tree.present
            if present is None or not self._state.can_learn:
                raise GyrocalError('the recording does not contradict the model', where='nothing to learn')
            self._start_task('learn', present.label, LearnLaw(present.model))

    def validate_on(self, recording: Bag) -> None:
        """Test the first model and the present one on another recording, with the coefficients of this one.

        Raises:
            GyrocalError: it is the same recording, the model has not run, or another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            if recording.title == self._recording.title:
                todo = 'choose another one'
                raise GyrocalError('was used to fit the models', where=recording.title, todo=todo)
            kept = self.improvement().kept
            trained = {one.label: conclude(one.examined.run) for one in (kept[0], kept[-1])}
            self._start_task('validate', recording.title, ValidateModels(recording, trained))

    def go_to(self, label: str) -> None:
        """Make another tried model the present one.

        Raises:
            GyrocalError: there is no such model, or another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            if self._state.tree.find(label) is None:
                raise GyrocalError('there is no such revision', where=label)
            self._set_present(label, f'{label} is the present model.')

    def undo(self) -> None:
        """Remove the last effect from the present model; the larger model stays in the history.

        Raises:
            GyrocalError: no effect was added, or another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            present = self._state.tree.present
            if present is None or present.builds_on is None:
                raise GyrocalError('no effect has been added yet', where='undo')
            removed = present.model.effects[-1].name
            self._set_present(present.builds_on, f'{removed} has been removed from the model.')

    def cancel(self) -> None:
        """Stop the running task."""
        self._worker.cancel()

    def resume(self) -> None:
        """Start again what was cancelled or has failed.

        Raises:
            GyrocalError: another task is running.
        """
        with self._changed:
            self._refuse_while_busy()
            if self._state.recorded is None:
                self._start_task('open', self._recording.title, OpenRecording(self._recording, self._model))
            else:
                self._run_next()

    def write(self) -> Path:
        """Write model.yaml and calibration.yaml of the present model; return their folder.

        Raises:
            GyrocalError: the model has not run yet, or they cannot be written.
        """
        with self._changed:
            store.save_result(self._folder, self.improvement())
            self.show_message(f'model.yaml and calibration.yaml are in {self._folder}.')
            return self._folder

    def show_message(self, message: str, is_error: bool = False) -> None:
        """Show a message to the user."""
        with self._changed:
            self._publish(message=message, is_error=is_error)

    def guess(self, effect: str | None) -> None:
        """Store the user's guess of the hidden effect."""
        with self._changed:
            self._publish(guess=effect)

    def reveal(self) -> None:
        """Open the answer, and compare it with the present model.

        Raises:
            GyrocalError: there is no answer, or the model has not run yet.
        """
        with self._changed:
            if self._answer is None and isinstance(self._recording, Bag):
                self._answer = unseal(self._recording.path)
            examination = self._state.examination
            if self._answer is None or examination is None:
                raise GyrocalError('the model has not run yet', where='reveal')
            added = tuple(tried.model.effects[-1].name for tried in self._state.tree.chain[1:])
            found = conclude(examination.examined.run)
            self._publish(revealed=reveal(self._answer, self._state.guess, found, added, set(EFFECTS)))

    def improvement(self) -> Improvement:
        """Return the tried models as revisions.

        Raises:
            GyrocalError: the present model, or one that it builds on, has not run yet.
        """
        improved = self._state.improvement
        if improved is None:
            raise GyrocalError('the model has not run yet', where=self._state.title, todo='wait a moment')
        return improved

    # --- messages of the worker ------------------------------------------------------------------

    def receive(self, number: int, message: TaskMessage) -> None:
        """Process a message about a task.

        Args:
            number: number of the task; messages about earlier tasks are ignored.
            message: progress, or a result.
        """
        with self._changed:
            running = self._state.running
            if running is None or number != running.number:
                return
            if isinstance(message, TaskProgress):
                self._publish(running=replace(running, progress=message))
            elif isinstance(message, RecordingContents):
                self._publish(contents=message)
            elif isinstance(message, RunPreview):
                if running.kind != 'forecast':
                    self._publish(preview=message)
            elif isinstance(message, Failed | Stopped):
                self._end_task(running, message)
            else:
                try:
                    self._finish_task(running, message)
                except GyrocalError as error:
                    self._publish(running=None, message=str(error), is_error=True)

    def _end_task(self, running: RunningTask, message: Failed | Stopped) -> None:
        self._publish(running=None, preview=None)
        if isinstance(message, Stopped):
            self.show_message(f'Cancelled: {TASK_TEXT[running.kind].format(running.subject)}.')
        elif running.kind != 'forecast':
            self.show_message(message.why, is_error=True)

    def _finish_task(
        self, running: RunningTask, message: Ready | Examination | LearnedResult | ValidationResult
    ) -> None:
        self._publish(running=None, preview=None)
        tree = self._state.tree
        if isinstance(message, Ready):
            self._answer = message.answer
            self._publish(recorded=message.recorded, tree=store.load(self._folder, self._identity()))
            self._run_next()
        elif isinstance(message, LearnedResult):
            self._propose(running.subject, message)
        elif isinstance(message, ValidationResult):
            self._publish(validated={**self._state.validated, message.recording: message.models})
        elif running.kind == 'begin':
            self._commit(tree.with_first(message), '')
        elif running.kind == 'add':
            self._add_examination(message)
        elif running.kind == 'forecast':
            key = (running.parent or '', running.subject)
            earlier = list(self._state.forecasts.items())[-MAX_EARLIER_FORECASTS:]
            self._publish(forecasts={**dict(earlier), key: message})
        else:
            self._publish(tree=tree.with_examination(running.subject, message))
            self._run_next()

    def _run_next(self) -> None:
        """Run a model that has not run in this process, the present one first."""
        tried = self._state.tree.next_to_run
        if not self._state.tree.models:
            self._start_task('begin', self._model.name, Examine(self._model, is_first=True))
        elif tried is not None:
            self._start_task('replay', tried.label, Examine(tried.model))

    # --- the state -------------------------------------------------------------------------------

    def _start_task(self, kind: str, subject: str, task: Task) -> None:
        if self._state.running is not None:
            self._worker.cancel()
        number = self._worker.submit(task)
        progress = TaskProgress(0.0, TASK_TEXT[kind].format(subject))
        running = RunningTask(number, kind, subject, self._state.tree.present_label, progress)
        self._publish(running=running, message='', is_error=False)

    def _add_examination(self, examination: Examination) -> None:
        effect = examination.examined.model.effects[-1].name
        before = self.improvement().final
        self._commit(self._state.tree.with_addition(examination), '')
        after = self.improvement().final
        drift = f'{before.held_out.rms_deg:.2f} to {after.held_out.rms_deg:.2f} deg'
        self.show_message(f'{effect} is in the model: held-out drift from {drift}.')

    def _propose(self, label: str, learned: LearnedResult) -> None:
        """Offer what was learned beside a model."""
        found, curve = learned.examination, learned.as_curve
        proposal = Proposal(found, curve, learned.gain, learned.sigma) if found and curve else None
        self._publish(learned={**self._state.learned, label: proposal})

    def _set_present(self, label: str, message: str) -> None:
        self._commit(replace(self._state.tree, present_label=label), message)

    def _commit(self, tree: ModelTree, message: str) -> None:
        """Write the new tree to disk, then publish it."""
        new = {tried.label for tried in tree.models} - {tried.label for tried in self._state.tree.models}
        improved = tree.improvement()
        for revision in improved.revisions if improved is not None else ():
            if revision.label in new:
                store.save_revision(self._folder, revision)
        store.save_state(self._folder, self._identity(), tree)
        self._publish(tree=tree, running=None, message=message, is_error=False, revealed=None)

    def _identity(self) -> dict[str, Any]:
        """Return properties that distinguish the recording from others."""
        contents = self._state.contents
        assert contents is not None
        return identity(self._recording, contents)

    def _model_with(self, effect: str) -> SensorModel:
        examination = self._state.examination
        if examination is None:
            raise GyrocalError('the model has not run yet', where=effect, todo='wait a moment')
        examined = examination.examined
        if any(one.name == effect for one in examined.model.effects):
            raise GyrocalError('is in the model already', where=effect)
        if effect.partition(':')[0] in LEARNED_EFFECTS:
            raise GyrocalError('has not been learned yet', where=effect, todo='press "Learn this"')
        limit = next((one for one in examination.limits if one.name == effect), None)
        if limit is not None:
            return with_effect(examined.model, limit)
        return wider_model(examined, find_effect(effect))

    def _refuse_while_busy(self) -> None:
        if self._state.is_busy:
            raise GyrocalError('another task is running', where='studio', todo='wait for it, or cancel it')

    def _publish(self, **changes: Any) -> None:
        self._state = replace(self._state, **changes, version=self._state.version + 1)
        self._changed.notify_all()
