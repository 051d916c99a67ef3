"""The error falling, revision by revision: what a search has tried, with its figures of merit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gyrocal_ros.diagnose.drift import (
    BlindDrift,
    Trajectory2D,
    better_sigma,
    blind_drift,
    held_out_from_s,
    reference_path,
)
from gyrocal_ros.diagnose.predictive_gain import predictive_gain, vuong_sigma
from gyrocal_ros.diagnose.search import Addition, ExaminedModel, Search
from gyrocal_ros.model.sensor import Effect

CHANCE_SIGMA = 2.0
"""A difference of less than this may be chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Revision:
    """One model that was tried."""

    label: str
    """`0_default`, `1_scale_asymmetry`: the name of its folder."""
    effect: Effect | None
    """What was added to the revision that it builds on; None for the model as it was."""
    stage: ExaminedModel
    is_kept: bool
    held_out: BlindDrift
    """Each span begins with what was known by then."""
    fitted: BlindDrift
    """The same spans with the final coefficients."""
    gain: float
    """Log-likelihood by which it foresees the recording better than what it builds on; 0 for the first."""
    gain_sigma: float
    """By how many sigma that is more than chance."""
    drift_sigma: float
    """By how many sigma its held-out drift is smaller than that of what it builds on; NaN where not known."""
    why: str
    """In one sentence, why it was kept or not."""


@dataclass(frozen=True, slots=True, eq=False)
class Improvement:
    """All revisions in the order in which they were tried."""

    revisions: tuple[Revision, ...]
    drift_reference: str
    """What headings were compared with for the drift: `ground truth`, or `slam` by the final model."""

    @property
    def kept(self) -> tuple[Revision, ...]:
        """The revisions that make up the final model, the model as it was among them."""
        return tuple(revision for revision in self.revisions if revision.is_kept)

    @property
    def final(self) -> Revision:
        """The last one that was kept."""
        return self.kept[-1]


def improvement(searched: Search) -> Improvement:
    """Take a finished search apart into revisions."""
    reference = reference_path(searched.last.run)
    revisions: list[Revision] = []
    if not searched.changes or searched.changes[0].before is not None:
        revisions.append(first_revision(searched.first, reference))
    for number, change in enumerate(searched.changes, start=1):
        label = revision_label(number, change.effect.name)
        revisions.append(revision(change, label, reference, change.is_kept))
    return Improvement(tuple(revisions), reference[1])


def revision_label(number: int, name: str) -> str:
    """`1_scale_asymmetry`, in letters that every file system takes."""
    plain = re.sub(r'[^\w.]+', '_', name)
    return f'{number}_{plain}'


def first_revision(stage: ExaminedModel, reference: tuple[Trajectory2D, str]) -> Revision:
    """The model as it was.

    Args:
        stage: that model on the recording.
        reference: headings to compare with, and what they are called.
    """
    held_out, fitted = _drifts(stage, reference)
    label = revision_label(0, stage.model.name)
    return Revision(
        label, None, stage, True, held_out, fitted, 0.0, 0.0, 0.0, 'the model as it was'
    )  # fmt: skip


def revision(change: Addition, label: str, reference: tuple[Trajectory2D, str], is_kept: bool) -> Revision:
    """The model with one more effect.

    Args:
        change: what was put in.
        label: of the revision.
        reference: headings to compare with, and what they are called.
        is_kept: whether it is part of the final model.
    """
    held_out, fitted = _drifts(change.after, reference)
    gain_sigma = drift_sigma = float('nan')
    why = f'{"kept" if is_kept else "left out"}: {_reason(change)}'
    if change.before is not None:
        before = _drifts(change.before, reference)[0]
        gain_sigma = vuong_sigma(predictive_gain(change.before.run, change.after.run))
        drift_sigma = better_sigma(before, held_out)
        why = f'{why}; {_drift_in_words(before, held_out)}'
    return Revision(
        label=label,
        effect=change.effect,
        stage=change.after,
        is_kept=is_kept,
        held_out=held_out,
        fitted=fitted,
        gain=change.predictive_gain,
        gain_sigma=gain_sigma,
        drift_sigma=drift_sigma,
        why=why,
    )


def _reason(change: Addition) -> str:
    if change.before is None:
        return 'without it the filter loses the measurements'
    size = f'{abs(change.predictive_gain):.1f}'
    if change.is_kept:
        return f'what follows is foreseen better (log-likelihood +{size})'
    if not change.stands_out:
        return 'beside the other coefficients it cannot be told from zero'
    if change.predictive_gain < 0.0:
        return f'what follows is foreseen worse (log-likelihood -{size})'
    return f'what follows is foreseen hardly better (log-likelihood +{size})'


def _drift_in_words(before: BlindDrift, after: BlindDrift) -> str:
    sigma = better_sigma(before, after)
    if math.isnan(sigma):
        return 'no span is long enough to tell the drift'
    old, new = f'{before.rms_deg:.2f}', f'{after.rms_deg:.2f}'
    if old == new:
        return f'the held-out drift stayed at {new} deg'
    word = 'fell' if sigma > 0.0 else 'rose'
    return f'the held-out drift {word} from {old} to {new} deg ({abs(sigma):.1f} sigma)'


def _drifts(stage: ExaminedModel, reference: tuple[Trajectory2D, str]) -> tuple[BlindDrift, BlindDrift]:
    """Held out and fitted, of the same spans."""
    from_s = held_out_from_s(stage.run)
    held_out, fitted = (blind_drift(stage.run, reference, from_s, fitted=end) for end in (False, True))
    return held_out, fitted
