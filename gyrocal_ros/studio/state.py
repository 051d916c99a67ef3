"""The state of a session, as one value that never changes: what the page is made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from gyrocal_ros.diagnose.improvement import Improvement
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.studio.lesson import Reveal
from gyrocal_ros.studio.recordings import Contents
from gyrocal_ros.studio.revisions import ModelTree
from gyrocal_ros.studio.worker import Advance, Examined, RunPreview


@dataclass(frozen=True, slots=True)
class Doing:
    """What is under way."""

    number: int
    """Of the task."""
    what: str
    """`open`, `begin`, `add`, `forecast` or `replay`."""
    subject: str
    """The effect or the trial that it is about."""
    parent: str | None
    """The trial that was the present one when it began."""
    advance: Advance


@dataclass(frozen=True, eq=False)
class StudioState:
    """The state of a session at one moment. Nothing in it changes."""

    version: int = 0
    """Grows with every change."""
    title: str = ''
    contents: Contents | None = None
    recorded: RecordingSummary | None = None
    doing: Doing | None = None
    glimpse: RunPreview | None = None
    trials: ModelTree = field(default_factory=ModelTree)
    forecasts: Mapping[tuple[str, str], Examined] = field(default_factory=dict)
    """By label of the trial and name of the effect: what would come of adding it."""
    message: str = ''
    """The last thing that a person should know."""
    is_trouble: bool = False
    """Whether the message tells of something that did not work."""
    has_answer: bool = False
    guess: str | None = None
    revealed: Reveal | None = None

    @property
    def is_busy(self) -> bool:
        """Whether nothing can be added just now; a forecast makes way."""
        return self.doing is not None and self.doing.what != 'forecast'

    @property
    def examined(self) -> Examined | None:
        """What there is to tell of the present model; None before it has run."""
        now = self.trials.now
        return None if now is None else now.examined

    @cached_property
    def improvement(self) -> Improvement | None:
        """The trials as revisions with their figures of merit."""
        return self.trials.improvement()

    def forecast(self, effect: str) -> Examined | None:
        """What would come of adding an effect to the present model, where that is known."""
        known = self.trials.known(effect)
        if known is not None and known.examined is not None:
            return known.examined
        return self.forecasts.get((self.trials.present or '', effect))
