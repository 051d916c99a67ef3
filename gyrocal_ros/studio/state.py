"""The state of a session as an immutable value, from which the page is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from gyrocal_ros.diagnose.analysis.validation import Validation
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, learned_laws
from gyrocal_ros.diagnose.search.improvement import Improvement
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.studio.lesson import Reveal
from gyrocal_ros.studio.recordings import RecordingContents
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.tasks import Examination, RunPreview, TaskProgress

TASK_TEXT = {
    'open': 'opening {}',
    'begin': 'the first run',
    'add': 'adding {}',
    'forecast': 'running {} in advance',
    'learn': 'learning beside {}',
    'replay': 'running {} again',
    'validate': 'testing on {}',
}
"""Text of a task by its kind."""


@dataclass(frozen=True, slots=True)
class RunningTask:
    """The task that the worker is doing."""

    number: int
    """Number of the task."""
    kind: str
    """A key of `TASK_TEXT`."""
    subject: str
    """Name of the effect, label of the model, or title of the recording."""
    parent: str | None
    """Label of the model that was the present one when the task began."""
    progress: TaskProgress


@dataclass(frozen=True, eq=False)
class Proposal:
    """A law that was learned beside a model, and may be added to it."""

    examination: Examination
    """Examination of the model with the law."""
    as_curve: Examination
    """The same of the curve or memory as it was learned, before it was written in closed form."""
    gain: float
    """Marginal log-likelihood that the law gains."""
    sigma: float

    @property
    def name(self) -> str:
        """Name of the law as an effect."""
        return self.examination.examined.model.effects[-1].name

    @cached_property
    def law(self) -> LearnedLaw:
        """The law with its curve and its closed forms."""
        learned_in = self.as_curve.examined
        learned = {self.name: (learned_in.model.effects[-1], learned_in)}
        return list(learned_laws(self.examination.examined, learned))[-1]


@dataclass(frozen=True, eq=False)
class StudioState:
    """The state of a session at one moment."""

    version: int = 0
    """Number of changes since the session was opened."""
    title: str = ''
    contents: RecordingContents | None = None
    recorded: RecordingSummary | None = None
    running: RunningTask | None = None
    preview: RunPreview | None = None
    tree: ModelTree = field(default_factory=ModelTree)
    forecasts: Mapping[tuple[str, str], Examination] = field(default_factory=dict)
    """Runs in advance of models with one more effect, by label of the model and name of the effect."""
    learned: Mapping[str, Proposal | None] = field(default_factory=dict)
    """Laws that were learned, by label of the model; None where no law predicts the recording better."""
    validated: Mapping[str, Mapping[str, Validation]] = field(default_factory=dict)
    """Models on other recordings, by title of the recording and label of the model."""
    message: str = ''
    """Last message to the user."""
    is_error: bool = False
    """True if the message reports an error."""
    has_answer: bool = False
    """True if the hidden effects of the recording can be revealed."""
    guess: str | None = None
    revealed: Reveal | None = None

    @property
    def is_busy(self) -> bool:
        """True if no effect can be added now; a forecast is cancelled by other work and does not count."""
        return self.running is not None and self.running.kind != 'forecast'

    @property
    def examination(self) -> Examination | None:
        """Examination of the present model; None before it has run."""
        present = self.tree.present
        return None if present is None else present.examination

    @cached_property
    def improvement(self) -> Improvement | None:
        """The tried models as revisions with their figures of merit."""
        return self.tree.improvement()

    @property
    def proposal(self) -> Proposal | None:
        """The law that was learned beside the present model; None without one."""
        return self.learned.get(self.tree.present_label or '')

    @property
    def can_learn(self) -> bool:
        """True if the recording contradicts the present model, and nothing was learned beside it yet."""
        contradicts = self.examination is not None and self.examination.is_contradicted
        return contradicts and self.tree.present_label not in self.learned

    def forecast(self, effect: str) -> Examination | None:
        """Return the examination of the present model with one more effect, if it has run."""
        if self.proposal is not None and self.proposal.name == effect:
            return self.proposal.examination
        tried = self.tree.find_addition(effect)
        if tried is not None and tried.examination is not None:
            return tried.examination
        return self.forecasts.get((self.tree.present_label or '', effect))
