"""The revisions of a model that a search has tried, with their figures of merit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from gyrocal_ros.diagnose.analysis.drift import (
    BlindDrift,
    better_sigma,
    blind_drift,
    drift_by_noise_deg,
    held_out_from_s,
    reference_heading,
)
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.paths import Heading
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.search.additions import Addition, Removal, Search
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.statistics import vuong_sigma

CHANCE_SIGMA = 2.0
"""Difference below which two revisions may differ by chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Revision:
    """One model that was tried."""

    label: str
    """Name of its folder: `0_default`, `1_scale_asymmetry`."""
    effect: Effect | None
    """Effect added to the revision that it builds on; None for the first model, and where one was removed."""
    examined: ExaminedModel
    fate: str
    """`kept`, `left out`, `removed again`, or `rewritten`: in closed form, as another revision."""
    held_out: BlindDrift
    """Held-out blind drift: each span starts with what was known by then."""
    fitted: BlindDrift
    """Blind drift of the same spans with the final coefficients."""
    gain: float
    """Predictive log-likelihood gained over the revision that it builds on; 0 for the first."""
    gain_sigma: float
    """Significance of that gain."""
    drift_sigma: float
    """Significance of the decrease of the held-out drift; NaN where unknown."""
    why: str
    """Sentence that says why it was kept or not."""

    @property
    def is_kept(self) -> bool:
        """True if it is part of the final model."""
        return self.fate == 'kept'


@dataclass(frozen=True, slots=True, eq=False)
class Improvement:
    """All revisions in the order in which they were tried."""

    revisions: tuple[Revision, ...]
    drift_reference: str
    """Reference of the drift: `ground truth`, or `slam` by the final model."""
    harmful: tuple[str, ...] = ()
    """Noises that the gyro has, and that are left out because the robot drifts more with them."""
    has_learned: bool = False
    """True if laws were tried that no effect of the library has."""

    @property
    def kept(self) -> tuple[Revision, ...]:
        """Revisions that make up the final model, the first model included."""
        return tuple(revision for revision in self.revisions if revision.is_kept)

    @property
    def drift_by_noise_deg(self) -> float:
        """The held-out drift that noise explains with the final model; NaN without spans."""
        return drift_by_noise_deg(self.final.examined.run, self.final.held_out)

    @property
    def fell_sigma(self) -> float:
        """By how many sigma the held-out drift fell from the first model to the last; NaN where unknown."""
        return better_sigma(self.kept[0].held_out, self.final.held_out)

    @property
    def final(self) -> Revision:
        """The last revision that was kept."""
        return self.kept[-1]


def improvement(searched: Search, *, has_learned: bool = False) -> Improvement:
    """List the revisions of a finished search, after which laws may have been learned."""
    reference = reference_heading(searched.last.run)
    revisions: list[Revision] = []
    if not searched.additions or searched.additions[0].before is not None:
        revisions.append(first_revision(searched.first, reference))
    written = {item.effect.name for item in searched.kept if item.is_rewritten}
    steps: list[Addition | Removal] = [*searched.additions, *searched.removals]
    for number, item in enumerate(sorted(steps, key=lambda step: step.after.model.version), start=1):
        if isinstance(item, Removal):
            revisions.append(_removing(item, number, reference))
        else:
            label, is_kept = revision_label(number, _name(item)), item in searched.kept
            is_rewritten = item.is_kept and not is_kept and item.effect.name in written
            revisions.append(revision(item, label, reference, is_kept, is_rewritten))
    harmful = tuple(item.effect.name for item in searched.removals if item.is_harmful)
    return Improvement(tuple(revisions), reference[1], harmful, has_learned)


def revision_label(number: int, name: str) -> str:
    """Return a label such as `1_scale_asymmetry`, with characters that every file system accepts."""
    plain = re.sub(r'[^\w.]+', '_', name)
    return f'{number}_{plain}'


def _name(added: Addition) -> str:
    form = getattr(added.effect, 'form', '')
    return f'{added.effect.name}_as_{form}' if form else added.effect.name


def first_revision(examined: ExaminedModel, reference: tuple[Heading, str]) -> Revision:
    """Describe the first model.

    Args:
        examined: that model on the recording.
        reference: trajectory to compare with, and its name.
    """
    held_out, fitted = _drifts(examined, reference)
    return Revision(
        label=revision_label(0, examined.model.name),
        effect=None,
        examined=examined,
        fate='kept',
        held_out=held_out,
        fitted=fitted,
        gain=0.0,
        gain_sigma=0.0,
        drift_sigma=0.0,
        why='the first model',
    )


def revision(
    added: Addition,
    label: str,
    reference: tuple[Heading, str],
    is_kept: bool,
    is_rewritten: bool = False,
) -> Revision:
    """Describe a model with one more effect.

    Args:
        added: the effect and the models before and after.
        label: label of the revision.
        reference: trajectory to compare with, and its name.
        is_kept: True if it is part of the final model.
        is_rewritten: True if the final model has a closed form of it instead.
    """
    held_out, fitted = _drifts(added.after, reference)
    gain_sigma = drift_sigma = float('nan')
    fate = 'kept' if is_kept else ('removed again' if added.is_kept else 'left out')
    if is_rewritten:
        fate = 'rewritten'
    why = f'{fate}: {_reason(added)}'
    if added.before is not None:
        before = _drifts(added.before, reference)[0]
        gain_sigma = added.gain_sigma
        drift_sigma = better_sigma(before, held_out)
        why = f'{why}; {change_in_words(before, held_out)}'
    return Revision(
        label=label,
        effect=added.effect,
        examined=added.after,
        fate=fate,
        held_out=held_out,
        fitted=fitted,
        gain=added.predictive_gain,
        gain_sigma=gain_sigma,
        drift_sigma=drift_sigma,
        why=why,
    )


def _removing(removal: Removal, number: int, reference: tuple[Heading, str]) -> Revision:
    """Describe a model from which an effect was removed again."""
    name = removal.effect.name
    held_out, fitted = _drifts(removal.after, reference)
    before = _drifts(removal.before, reference)[0]
    why = (
        f'{name} was removed again: {removal_reason(removal)}; without it {change_in_words(before, held_out)}'
    )
    return Revision(
        label=revision_label(number, f'without_{name}'),
        effect=None,
        examined=removal.after,
        fate='kept',
        held_out=held_out,
        fitted=fitted,
        gain=removal.predictive_gain,
        gain_sigma=vuong_sigma(predictive_gain(removal.before.run, removal.after.run)),
        drift_sigma=better_sigma(before, held_out),
        why=why,
    )


def removal_reason(removal: Removal) -> str:
    """Return why an effect was removed, as a clause."""
    if removal.is_harmful:
        return 'the gyro has this noise, but the robot drifts more with it'
    if removal.was_beside_noise:
        return 'it was found beside a noise that is left out'
    if removal.is_needed:
        return 'beside the other effects it is smaller, and is added again'
    if math.isinf(removal.distance):
        return 'beside the other effects the recording is predicted as well without it'
    return f'beside the other effects it is {removal.distance:.1f} sigma from zero'


def _reason(added: Addition) -> str:
    if added.before is None:
        return 'without it the filter cannot follow the recording'
    size = f'{abs(added.predictive_gain):.1f}'
    if added.is_rewritten and added.is_kept:
        gain = f'{added.predictive_gain:+.1f}'
        what = 'in closed form' if getattr(added.effect, 'form', '') else 'with the likeliest period'
        return f'{what} the recording is predicted as well (log-likelihood {gain})'
    better = f'the recording is predicted better (log-likelihood +{size})'
    if added.together_with:
        gain = f'{added.predictive_gain:+.1f}'
        others = ' and '.join(added.together_with)
        return f'it explains the recording only together with {others} (log-likelihood {gain})'
    if added.is_kept:
        return better
    if not added.stands_out:
        return 'beside the other coefficients it is not significantly different from zero'
    if added.is_momentary:
        return 'its time constant went to zero: what is missing goes with the motion of the moment'
    if added.is_negligible:
        return 'it is far smaller than in real sensors: the trace of something that is not known exactly'
    if added.predictive_gain < 0.0:
        return f'the recording is predicted worse (log-likelihood -{size})'
    if added.raises_drift:
        return f'{better}, but it drifts more'
    if added.spoils_fit:
        return f'{better}, but the model fits without it and not with it: it is not constant'
    if added.objection:
        return f'{added.objection} (log-likelihood {added.predictive_gain:+.1f})'
    return f'the prediction of the recording hardly improves (log-likelihood +{size})'


def change_in_words(before: BlindDrift, after: BlindDrift) -> str:
    """Return by how much the held-out drift fell or rose, as a clause."""
    sigma = better_sigma(before, after)
    if math.isnan(sigma):
        return 'the recording is too short to measure the drift'
    old, new = f'{before.rms_deg:.2f}', f'{after.rms_deg:.2f}'
    if old == new:
        return f'the held-out drift stayed at {new} deg'
    word = 'fell' if sigma > 0.0 else 'rose'
    return f'the held-out drift {word} from {old} to {new} deg ({abs(sigma):.1f} sigma)'


def _drifts(examined: ExaminedModel, reference: tuple[Heading, str]) -> tuple[BlindDrift, BlindDrift]:
    """Compute the held-out and the fitted drift of the same spans."""
    from_s = held_out_from_s(examined.run)
    final = examined.run.history.coefficients[-1]
    held_out, fitted = (
        blind_drift(examined.run, reference, from_s, coefficients=known) for known in (None, final)
    )
    return held_out, fitted
