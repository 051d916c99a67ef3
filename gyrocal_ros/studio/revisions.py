"""The models that were tried on one recording: a tree, one of whose models is the present one."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gyrocal_ros.diagnose.analysis.drift import reference_heading
from gyrocal_ros.diagnose.search.additions import addition
from gyrocal_ros.diagnose.search.improvement import (
    Improvement,
    Revision,
    first_revision,
    revision,
    revision_label,
)
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.studio.tasks import Examination


@dataclass(frozen=True, slots=True, eq=False)
class TriedModel:
    """One model that was tried."""

    label: str
    """Name of its folder."""
    builds_on: str | None
    """Label of the model to which it adds an effect; None for the first."""
    model: SensorModel
    examination: Examination | None = None
    """None until it has run; after a restart of the studio it runs again."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelTree:
    """All models that were tried, in order of time, and the label of the present one."""

    models: tuple[TriedModel, ...] = ()
    present_label: str | None = None

    def find(self, label: str | None) -> TriedModel | None:
        """Return the model of that label."""
        return next((tried for tried in self.models if tried.label == label), None)

    @property
    def present(self) -> TriedModel | None:
        """The present model."""
        return self.find(self.present_label)

    @property
    def chain(self) -> tuple[TriedModel, ...]:
        """The present model and all that it builds on, the first one first."""
        chain: list[TriedModel] = []
        tried = self.present
        while tried is not None:
            chain.insert(0, tried)
            tried = self.find(tried.builds_on)
        return tuple(chain)

    @property
    def next_to_run(self) -> TriedModel | None:
        """The next model that has not run, the present one before all others."""
        return next(
            (one for one in (self.present, *self.models) if one is not None and one.examination is None), None
        )

    def find_addition(self, effect: str) -> TriedModel | None:
        """Return the tried model that adds the effect to the present one."""
        return next(
            (
                tried
                for tried in self.models
                if tried.builds_on == self.present_label
                and tried.builds_on is not None
                and tried.model.effects[-1].name == effect
            ),
            None,
        )

    def with_first(self, examination: Examination) -> ModelTree:
        """Return a tree of the first model."""
        model = examination.examined.model
        label = revision_label(0, model.name)
        return ModelTree((TriedModel(label, None, model, examination),), label)

    def with_addition(self, examination: Examination) -> ModelTree:
        """Return the tree with one more model, which builds on the present one and replaces it."""
        model = examination.examined.model
        label = revision_label(len(self.models), model.effects[-1].name)
        tried = TriedModel(label, self.present_label, model, examination)
        return ModelTree((*self.models, tried), label)

    def with_examination(self, label: str, examination: Examination) -> ModelTree:
        """Return the tree with the result of a run of one of its models."""
        models = [replace(one, examination=examination) if one.label == label else one for one in self.models]
        return replace(self, models=tuple(models))

    def improvement(self) -> Improvement | None:
        """Return the models that have run as revisions; those in the chain of the present model are kept.

        The drift is relative to the ground truth, or to the heading by the present model. None if a
        model of the chain has not run.
        """
        present = self.present
        if present is None or present.examination is None:
            return None
        reference = reference_heading(present.examination.examined.run)
        kept = {tried.label for tried in self.chain}
        revisions: list[Revision] = []
        for tried in self.models:
            before = self.find(tried.builds_on)
            if tried.examination is None:
                continue
            if before is None:
                first = first_revision(tried.examination.examined, reference)
                revisions.append(replace(first, label=tried.label))
            elif before.examination is not None:
                change = addition(before.examination.examined, tried.examination.examined)
                revisions.append(revision(change, tried.label, reference, tried.label in kept))
        is_complete = kept <= {item.label for item in revisions}
        return Improvement(tuple(revisions), reference[1]) if is_complete else None
