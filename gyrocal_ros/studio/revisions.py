"""What a person has tried on one recording: a tree of models, of which one is the present one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gyrocal_ros.diagnose.drift import reference_path
from gyrocal_ros.diagnose.improvement import (
    Improvement,
    Revision,
    first_revision,
    revision,
    revision_label,
)
from gyrocal_ros.diagnose.search import addition
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.studio.worker import Examined


@dataclass(frozen=True, slots=True, eq=False)
class TriedModel:
    """One model that was tried."""

    label: str
    """The name of its folder."""
    builds_on: str | None
    """Label of the trial that it adds an effect to; None for the first."""
    model: SensorModel
    examined: Examined | None = None
    """None until it has run; after a restart of the studio it runs again."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelTree:
    """All that were tried, in the order in which they were, and which is the present one."""

    every: tuple[TriedModel, ...] = ()
    present: str | None = None

    def find(self, label: str | None) -> TriedModel | None:
        """The trial of that label."""
        return next((trial for trial in self.every if trial.label == label), None)

    @property
    def now(self) -> TriedModel | None:
        """The present one."""
        return self.find(self.present)

    @property
    def chain(self) -> tuple[TriedModel, ...]:
        """The present trial and all that it builds on, the first one first."""
        chain: list[TriedModel] = []
        trial = self.now
        while trial is not None:
            chain.insert(0, trial)
            trial = self.find(trial.builds_on)
        return tuple(chain)

    @property
    def waiting(self) -> TriedModel | None:
        """The next one that has to run, the present one before all others."""
        return next(
            (one for one in (self.now, *self.every) if one is not None and one.examined is None), None
        )

    def known(self, effect: str) -> TriedModel | None:
        """That which adds the effect to the present one, if it was tried."""
        return next(
            (
                trial
                for trial in self.every
                if trial.builds_on == self.present
                and trial.builds_on is not None
                and trial.model.effects[-1].name == effect
            ),
            None,
        )

    def begun(self, examined: Examined) -> ModelTree:
        """With the first model, which has run."""
        model = examined.stage.model
        return ModelTree(
            (TriedModel(revision_label(0, model.name), None, model, examined),), revision_label(0, model.name)
        )

    def added(self, examined: Examined) -> ModelTree:
        """With one more, which builds on the present one and takes its place."""
        model = examined.stage.model
        label = revision_label(len(self.every), model.effects[-1].name)
        return ModelTree((*self.every, TriedModel(label, self.present, model, examined)), label)

    def ran(self, label: str, examined: Examined) -> ModelTree:
        """With what came of running one of them."""
        every = [replace(one, examined=examined) if one.label == label else one for one in self.every]
        return replace(self, every=tuple(every))

    def improvement(self) -> Improvement | None:
        """Those that have run as revisions; those that make up the present model count as kept.

        Drifts are told against the ground truth or the present model. None before anything has run.
        """
        now = self.now
        if now is None or now.examined is None:
            return None
        reference = reference_path(now.examined.stage.run)
        kept = {trial.label for trial in self.chain}
        revisions: list[Revision] = []
        for trial in self.every:
            before = self.find(trial.builds_on)
            if trial.examined is None:
                continue
            if before is None:
                revisions.append(replace(first_revision(trial.examined.stage, reference), label=trial.label))
            elif before.examined is not None:
                change = addition(before.examined.stage, trial.examined.stage)
                revisions.append(revision(change, trial.label, reference, trial.label in kept))
        complete = kept <= {item.label for item in revisions}
        return Improvement(tuple(revisions), reference[1]) if complete else None
