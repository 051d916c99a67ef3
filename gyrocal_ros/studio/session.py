"""What a person does with one recording: a state machine that knows neither browser nor ROS.

Everything that can be done is a method; each answers at once, long work goes to the worker. `view`
gives the state as one frozen value. Whatever is done is written to the session's folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from threading import Condition
from typing import Any, Protocol

from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.diagnose.search import wider_model, with_effect
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.sealed import sealed_path, unseal
from gyrocal_ros.studio import store
from gyrocal_ros.studio.lesson import reveal
from gyrocal_ros.studio.recordings import Bag, Contents, HiddenEffectTask
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.state import Doing, StudioState
from gyrocal_ros.studio.worker import (
    Advance,
    Examine,
    Examined,
    Failed,
    News,
    OpenRecording,
    Ready,
    RunPreview,
    Stopped,
    Task,
)

MOST_FORECASTS = 5
"""So many are remembered beside the last one; each takes some megabytes."""


class Works(Protocol):
    """What does the long work."""

    def submit(self, task: Task) -> int: ...

    def cancel(self) -> None: ...


class Session:
    """One recording on the desk. Safe to use from several threads."""

    def __init__(
        self, recording: Bag | HiddenEffectTask, model: SensorModel, folder: Path, worker: Works
    ) -> None:
        """Begin to read the recording.

        Args:
            recording: what to work on.
            model: to begin with, where the folder knows of no other.
            folder: of the session, kept from others as long as this one is open.
            worker: does the long work; `hear` is to be told its news.

        Raises:
            GyrocalError: another studio works in the folder.
        """
        self._recording, self._model, self._folder, self._worker = recording, model, folder, worker
        self._changed = Condition()
        self._answer: Mapping[str, Any] | None = None
        self._open = ExitStack()
        self._open.enter_context(store.locked(folder))
        has_answer = isinstance(recording, HiddenEffectTask) or sealed_path(recording.path).is_file()
        self._view = StudioState(title=recording.title, has_answer=has_answer)
        with self._changed:
            self._begin('open', recording.title, OpenRecording(recording, model))

    @property
    def view(self) -> StudioState:
        """The present state."""
        return self._view

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        return self._folder

    def wait(self, reached: Callable[[StudioState], bool], timeout_s: float) -> StudioState:
        """Wait until the state is as wanted, or the time is up; returns the state."""
        with self._changed:
            self._changed.wait_for(lambda: reached(self._view), timeout_s)
            return self._view

    def close(self) -> None:
        """Let the folder go; what the worker still tells is not heard any more."""
        with self._changed:
            self._view = replace(self._view, doing=None)
            self._open.close()

    # --- what a person does ----------------------------------------------------------------------

    def add(self, effect: str) -> None:
        """Put an effect into the present model and fit it.

        Raises:
            GyrocalError: it cannot be added, or something else is under way.
        """
        with self._changed:
            self._refuse_while_busy()
            view = self._view
            known = view.trials.known(effect)
            if known is not None:
                self._set_present(known.label, f'{effect} is in the model again.')
                return
            ahead = view.forecast(effect)
            if ahead is not None:
                self._take_in(ahead)
                return
            model = self._model_with(effect)
            doing = view.doing
            if doing is not None and (doing.subject, doing.parent) == (effect, view.trials.present):
                self._publish(doing=replace(doing, what='add'), message='')  # it is being run already
                return
            self._begin('add', effect, Examine(model))

    def forecast(self, effect: str) -> None:
        """Find out what would come of adding an effect, unless something more urgent is under way.

        Raises:
            GyrocalError: it cannot be added.
        """
        with self._changed:
            view, doing = self._view, self._view.doing
            is_asked = doing is not None and doing.subject == effect
            if not view.is_busy and not is_asked and view.forecast(effect) is None:
                self._begin('forecast', effect, Examine(self._model_with(effect)))

    def go_to(self, label: str) -> None:
        """Make a trial the present one.

        Raises:
            GyrocalError: there is no such trial, or something is under way.
        """
        with self._changed:
            self._refuse_while_busy()
            if self._view.trials.find(label) is None:
                raise GyrocalError('there is no such revision', where=label)
            self._set_present(label, f'{label} is the present model.')

    def undo(self) -> None:
        """Take the last effect out again; the trial stays in the history.

        Raises:
            GyrocalError: nothing was added, or something is under way.
        """
        with self._changed:
            self._refuse_while_busy()
            now = self._view.trials.now
            if now is None or now.builds_on is None:
                raise GyrocalError('nothing was added yet', where='undo')
            self._set_present(now.builds_on, f'{now.model.effects[-1].name} is out of the model again.')

    def cancel(self) -> None:
        """Stop what is under way."""
        self._worker.cancel()

    def resume(self) -> None:
        """Go on where work was cancelled or failed.

        Raises:
            GyrocalError: something is under way.
        """
        with self._changed:
            self._refuse_while_busy()
            if self._view.recorded is None:
                self._begin('open', self._recording.title, OpenRecording(self._recording, self._model))
            else:
                self._replay()

    def write(self) -> Path:
        """Write the present model.yaml and calibration.yaml; returns their folder.

        Raises:
            GyrocalError: nothing has run yet, or they cannot be written.
        """
        with self._changed:
            store.save_result(self._folder, self.improvement())
            self._publish(message=f'model.yaml and calibration.yaml are in {self._folder}.', is_trouble=False)
            return self._folder

    def say(self, message: str, is_trouble: bool = False) -> None:
        """Tell the person something."""
        with self._changed:
            self._publish(message=message, is_trouble=is_trouble)

    def guess(self, effect: str | None) -> None:
        """Note what the person believes to be hidden."""
        with self._changed:
            self._publish(guess=effect)

    def reveal(self) -> None:
        """Open the answer, and hold the present model against it.

        Raises:
            GyrocalError: there is none, or nothing has run yet.
        """
        with self._changed:
            if self._answer is None and isinstance(self._recording, Bag):
                self._answer = unseal(self._recording.path)
            now = self._view.examined
            if self._answer is None or now is None:
                raise GyrocalError('the model has not run yet', where='reveal')
            added = tuple(trial.model.effects[-1].name for trial in self._view.trials.chain[1:])
            found = conclude(now.stage.run)
            self._publish(revealed=reveal(self._answer, self._view.guess, found, added, set(EFFECTS)))

    def improvement(self) -> Improvement:
        """The trials as revisions.

        Raises:
            GyrocalError: they have not all run yet.
        """
        improved = self._view.improvement
        if improved is None:
            raise GyrocalError('the model has not run yet', where=self._view.title, todo='wait a moment')
        return improved

    # --- what the worker tells -------------------------------------------------------------------

    def hear(self, number: int, news: News) -> None:
        """Take in news of a task."""
        with self._changed:
            doing = self._view.doing
            if doing is None or number != doing.number:
                return
            if isinstance(news, Advance):
                self._publish(doing=replace(doing, advance=news))
            elif isinstance(news, Contents):
                self._publish(contents=news)
            elif isinstance(news, RunPreview):
                if doing.what != 'forecast':
                    self._publish(glimpse=news)
            elif isinstance(news, Failed | Stopped):
                self._ended(doing, news)
            else:
                try:
                    self._done(doing, news)
                except GyrocalError as error:
                    self._publish(doing=None, message=str(error), is_trouble=True)

    def _ended(self, doing: Doing, news: Failed | Stopped) -> None:
        self._publish(doing=None, glimpse=None)
        if isinstance(news, Stopped):
            self._publish(message=f'Cancelled: {_WORDS[doing.what].format(doing.subject)}.', is_trouble=False)
        elif doing.what != 'forecast':
            self._publish(message=news.why, is_trouble=True)

    def _done(self, doing: Doing, news: Ready | Examined) -> None:
        self._publish(doing=None, glimpse=None)
        if isinstance(news, Ready):
            self._answer = news.answer
            self._publish(recorded=news.recorded, trials=store.load(self._folder, self._identity()))
            self._replay()
        elif doing.what == 'begin':
            self._commit(self._view.trials.begun(news), '')
        elif doing.what == 'add':
            self._take_in(news)
        elif doing.what == 'forecast':
            key = (doing.parent or '', doing.subject)
            kept = list(self._view.forecasts.items())[-MOST_FORECASTS:]
            self._publish(forecasts={**dict(kept), key: news})
        else:
            self._publish(trials=self._view.trials.ran(doing.subject, news))
            self._replay()

    def _replay(self) -> None:
        """Run what has not run in this process, the present model first."""
        waiting = self._view.trials.waiting
        if not self._view.trials.every:
            self._begin('begin', self._model.name, Examine(self._model, is_first=True))
        elif waiting is not None:
            self._begin('replay', waiting.label, Examine(waiting.model))

    # --- the state -------------------------------------------------------------------------------

    def _begin(self, what: str, subject: str, task: Task) -> None:
        if self._view.doing is not None:
            self._worker.cancel()
        number = self._worker.submit(task)
        advance = Advance(0.0, _WORDS[what].format(subject))
        doing = Doing(number, what, subject, self._view.trials.present, advance)
        self._publish(doing=doing, message='', is_trouble=False)

    def _take_in(self, examined: Examined) -> None:
        effect = examined.stage.model.effects[-1].name
        before = self.improvement().final
        self._commit(self._view.trials.added(examined), '')
        after = self.improvement().final
        drift = f'{before.held_out.rms_deg:.2f} to {after.held_out.rms_deg:.2f} deg'
        self._publish(message=f'{effect} is in the model: held-out drift from {drift}.', is_trouble=False)

    def _set_present(self, label: str, message: str) -> None:
        self._commit(replace(self._view.trials, present=label), message)

    def _commit(self, trials: ModelTree, message: str) -> None:
        """Make it so, on disk first."""
        new = {trial.label for trial in trials.every} - {trial.label for trial in self._view.trials.every}
        improved = trials.improvement()
        for revision in improved.revisions if improved is not None else ():
            if revision.label in new:
                store.save_revision(self._folder, revision)
        store.save_state(self._folder, self._identity(), trials)
        self._publish(trials=trials, doing=None, message=message, is_trouble=False, revealed=None)

    def _identity(self) -> dict[str, Any]:
        """What tells the recording from others."""
        contents = self._view.contents
        assert contents is not None
        if isinstance(self._recording, HiddenEffectTask):
            return {'seed': self._recording.seed, 'duration_s': contents.duration_s}
        assert contents.check is not None
        topics = {topic.name: topic.count for topic in contents.check.topics}
        options = {name: value for name, value in self._recording.options.items() if value}
        return {'duration_s': contents.duration_s, 'messages': topics, **options}

    def _model_with(self, effect: str) -> SensorModel:
        now = self._view.examined
        if now is None:
            raise GyrocalError('the model has not run yet', where=effect, todo='wait a moment')
        if any(one.name == effect for one in now.stage.model.effects):
            raise GyrocalError('is in the model already', where=effect)
        limit = next((one for one in now.limits if one.name == effect), None)
        if limit is not None:
            return with_effect(now.stage.model, limit)
        return wider_model(now.stage, find_effect(effect))

    def _refuse_while_busy(self) -> None:
        if self._view.is_busy:
            raise GyrocalError('something is under way', where='studio', todo='wait for it, or cancel it')

    def _publish(self, **changes: Any) -> None:
        self._view = replace(self._view, **changes, version=self._view.version + 1)
        self._changed.notify_all()


_WORDS = {
    'open': 'opening {}',
    'begin': 'the first run',
    'add': 'adding {}',
    'forecast': 'trying {} in advance',
    'replay': 'running {} again',
}
