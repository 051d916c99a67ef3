"""The diagnosis: which physical effect the sensor model lacks, with its uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import (
    BlindDrift,
    blind_drift,
    drifts_more,
    held_out_from_s,
    reference_heading,
)
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.limits import proven_limits
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit, model_fit
from gyrocal_ros.diagnose.analysis.ranking import (
    RankedEffect,
    estimate,
    estimate_stds,
    indistinguishable,
)
from gyrocal_ros.diagnose.analysis.regimes import Failure, failures
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure, turns_enough
from gyrocal_ros.diagnose.analysis.summarise import coarse_step
from gyrocal_ros.diagnose.search.additions import NONE, Addition, Search
from gyrocal_ros.diagnose.search.look_alikes import look_alikes
from gyrocal_ros.diagnose.search.timing import TimingFault, stamp_jitter, timing_fault
from gyrocal_ros.diagnose.search.uneven import uneven_sign
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.diagnose.unknown_law import structure_of
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import (
    is_estimated,
    is_noise,
    is_unusual,
    shows_in_any_turns,
    why_unobservable,
)
from gyrocal_ros.ekf.history.turn_agreement import camera_knock, camera_yaw_fault
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, coefficient_names, with_means

BY_YAW = ('camera', 'wheels', 'ground', 'noise')
"""Places of effects that a wrong yaw of the camera imitates."""


@dataclass(frozen=True, slots=True, eq=False)
class MissingEffect:
    """One effect that the model lacks."""

    effect: Effect
    """The effect; its prior means are the estimates."""
    values: Array
    stds: Array
    """(k,) by the final run; the standard deviations are those that the scatter over it supports."""
    gain: float
    """Log-likelihood gained."""
    sigma: float
    p_value: float
    drift_before_deg: float
    drift_after_deg: float
    """Held-out blind drift, in spans that begin when the effect is known, and with what was known by then;
    NaN where no such span is left."""
    confused_with: tuple[str, ...]
    """Effects that this recording cannot distinguish from it."""
    together_with: tuple[str, ...] = ()
    """Effects beside which alone it explains the recording: the model needs all of them."""
    raises_drift: bool = False
    """True for a noise with which the robot drifts more: with the right one it would drift less."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return coefficient_names(self.effect)

    @property
    def is_unusual_noise(self) -> bool:
        """True for a noise that is far larger than that of any usual gyro."""
        return is_noise(self.effect) and is_unusual(self.effect, float(self.values[0]))


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """The conclusion from one recording: effects that the model lacks, and what is left over."""

    verdict: str
    """`nothing_missing`, `effect_found`, `noise`, `timing`, `cannot_tell` or `unexplained`."""
    missing: tuple[MissingEffect, ...]
    """Missing effects, the one that explains most first."""
    ranked: tuple[RankedEffect, ...]
    """All candidates beside the first model, the best first."""
    not_judged: dict[str, str]
    """Effects that this recording cannot judge, and why."""
    unexplained: UnexplainedStructure | None
    """Structure that no effect explains; None without."""
    fails_where: tuple[Failure, ...]
    """Places where the first model is off by more than chance, worst first."""
    fit: ModelFit
    """Whether the model with the effects found fits."""
    drift_reference: str
    """The reference of the drift."""
    timing: TimingFault | None = None
    """The fault of the stamps; None without."""
    coarse_step_rad_s: float | None = None
    """Quantisation step of the gyro where it exceeds the noise: what is found may be its steps."""
    limits: tuple[str, ...] = ()
    """Limits that the readings suggest, not yet confirmed by a run."""
    proven_limits: tuple[Effect, ...] = ()
    """Limits that the readings prove, though the recording is not predicted better with them."""
    uneven: str = ''
    """Effect that would explain much, but not in all stretches alike: something else is missing."""
    wrong_yaw: str = ''
    """Clause on a camera whose yaw in its transform is wrong: neither camera nor wheels can be judged."""
    knock: str = ''
    """Clause on a knock of the camera."""
    rival_law: str = ''
    """Clause on a law that explains nearly as much as a noise that was found; empty without."""
    is_open: bool = False
    """True where no missing effect has been added yet: fit and structure are those of the model without."""

    @property
    def only_steps(self) -> bool:
        """True if the quantisation steps of the gyro are all that may cause the errors."""
        is_coarse = self.coarse_step_rad_s is not None and self.verdict == 'cannot_tell'
        return is_coarse and not self.missing and self.unexplained is not None

    @property
    def unusual_noise(self) -> list[str]:
        """Names of missing noises that are far larger than those of any usual gyro."""
        return [item.effect.name for item in self.missing if item.is_unusual_noise]

    @property
    def harmful_noise(self) -> list[str]:
        """Names of missing noises with which the robot drifts more."""
        return [item.effect.name for item in self.missing if item.raises_drift]


def diagnose(searched: Search, recording: RecordingSummary) -> Diagnosis:
    """Draw the conclusions from a search."""
    missing = sorted(_not_of_noise(_missing(searched)), key=lambda item: item.gain, reverse=True)
    if searched.last.unexplained_structure is not None:  # a noise that no gyro has stood for it
        missing = [item for item in missing if not item.is_unusual_noise]
    least = searched.last.settings.min_predictive_gain
    refuted = [item.effect.name for item in searched.additions if item.predictive_gain < least]
    rival = next((item.rival for item in searched.kept if item.rival is not None), None)
    found = _conclude(searched.first, searched.last, missing, recording, refuted)
    return found if rival is None else replace(found, rival_law=structure_of(rival).what)


def diagnose_before_adding(
    examined: ExaminedModel, best: RankedEffect | None, limits: Sequence[str], recording: RecordingSummary
) -> Diagnosis:
    """Draw the conclusions from one model to which nothing has been added yet.

    Structure that no effect explains is judged when `best` and the limits are in the model.

    Args:
        examined: the model.
        best: the effect that explains most; None without.
        limits: names of the limits that the readings suggest.
        recording: what the recording contains.
    """
    missing = [] if best is None else [_not_added(best, examined)]
    is_open = best is not None or len(limits) > 0
    found = _conclude(examined, examined, missing, recording)
    if not is_open:
        return found
    return replace(
        found,
        verdict='cannot_tell' if limits or found.timing is None else 'timing',
        unexplained=None,
        timing=None if limits else found.timing,
        limits=tuple(limits),
        is_open=True,
    )


def _conclude(
    first: ExaminedModel,
    last: ExaminedModel,
    missing: list[MissingEffect],
    recording: RecordingSummary,
    refuted: Collection[str] = (),
) -> Diagnosis:
    """Draw the conclusions from the first model and the last one.

    Args:
        first: the model that was given.
        last: the model with all that was found.
        missing: effects that were found.
        recording: what the recording contains.
        refuted: names of effects with which a run did not predict better.
    """
    not_judged = dict(_not_judged(last, recording))
    coarse_step_rad_s = coarse_step(recording.readings)
    structure, fit = last.unexplained_structure, model_fit(last.run)
    timing = None if fit.mounting else timing_fault(last)
    uneven = None
    if not missing and turns_enough(last.run):
        uneven = uneven_sign(last.ranked, refuted, last.settings)
    if uneven is not None:
        not_judged.pop(uneven.effect.name, None)
    is_coarse = coarse_step_rad_s is not None
    verdict = _verdict(missing, structure, uneven, not_judged, is_coarse, fit, last.settings)
    yaw = camera_yaw_fault(last.run)
    if yaw and all(item.effect.acts_on in BY_YAW for item in missing):
        verdict = 'cannot_tell' if verdict in ('nothing_missing', 'effect_found', 'noise') else verdict
    is_complete = verdict == 'nothing_missing'
    if is_complete:
        timing = timing or stamp_jitter(last.run)
    return Diagnosis(
        verdict='timing' if timing is not None else verdict,
        missing=tuple(missing),
        ranked=first.ranked,
        not_judged=not_judged,
        unexplained=structure,
        fails_where=tuple(failures(first.run, first.seen, first.settings, is_complete=is_complete)),
        fit=fit,
        drift_reference=reference_heading(last.run)[1],
        timing=timing,
        coarse_step_rad_s=coarse_step_rad_s,
        proven_limits=tuple(proven_limits(last.model, recording.readings)),
        uneven='' if uneven is None else uneven.effect.name,
        wrong_yaw=yaw,
        knock=camera_knock(last.run),
    )


def _not_of_noise(missing: Iterable[MissingEffect]) -> Iterator[MissingEffect]:
    """Leave out effects found beside a noise that raises the drift, if the robot drifts no less with them."""
    is_harmful = False
    for item in missing:
        if is_harmful and not is_noise(item.effect) and item.drift_after_deg >= item.drift_before_deg:
            continue
        is_harmful |= item.raises_drift
        yield item


def _missing(searched: Search) -> Iterator[MissingEffect]:
    run = searched.last.run
    reference = reference_heading(run)
    from_s = held_out_from_s(run)

    def drift(examined: ExaminedModel, known_from_s: float) -> BlindDrift:
        return blind_drift(examined.run, reference, max(from_s, known_from_s))

    confused = look_alikes(searched)
    for item in searched.kept:
        values, stds = searched.last.estimate_of(item.effect.name)
        group = _added_with(item, searched.kept)
        first, last = group[0], group[-1]
        before = drift(first.before, last.known_from_s) if first.before is not None else None
        after = drift(last.after, last.known_from_s)
        yield MissingEffect(
            effect=with_means(item.effect, values.tolist()),
            values=values,
            stds=np.maximum(stds, item.stds),
            gain=item.gain,
            sigma=item.sigma,
            p_value=item.p_value,
            drift_before_deg=before.rms_deg if before is not None else float('nan'),
            drift_after_deg=after.rms_deg,
            confused_with=confused.get(item.effect.name, ()),
            together_with=tuple(other.effect.name for other in group if other is not item),
            raises_drift=before is not None and is_noise(item.effect) and drifts_more(before, after),
        )


def _added_with(item: Addition, kept: Sequence[Addition]) -> list[Addition]:
    """Return the effects that explain a recording only together, one of them given, in their order.

    Some may have been removed again, beside what was found later.
    """
    return [other for other in kept if other.effect.name in {item.effect.name, *item.together_with}]


def _not_added(best: RankedEffect, examined: ExaminedModel) -> MissingEffect:
    """Return an effect by its score statistics alone; the drift with it is not known."""
    others = [item for item in examined.ranked if item is not best]
    confused = indistinguishable(best, others, examined.scores, NONE, examined.settings)
    values = estimate(best)
    return MissingEffect(
        effect=with_means(best.effect, values.tolist()),
        values=values,
        stds=estimate_stds(best),
        gain=best.fit.gain,
        sigma=best.fit.sigma,
        p_value=best.fit.p_value,
        drift_before_deg=float('nan'),
        drift_after_deg=float('nan'),
        confused_with=tuple(confused),
    )


def _verdict(
    missing: list[MissingEffect],
    left: UnexplainedStructure | None,
    uneven: RankedEffect | None,
    not_judged: dict[str, str],
    is_coarse: bool,
    fit: ModelFit,
    settings: DiagnosisSettings,
) -> str:
    if fit.mounting:
        return 'cannot_tell'
    if left is not None and _outweighs(left, missing, fit, settings):
        return 'cannot_tell' if is_coarse else 'unexplained'
    if missing and fit.fits is not False and all(is_noise(item.effect) for item in missing):
        return 'noise'
    if missing:
        is_ambiguous = is_coarse or fit.fits is False or any(item.confused_with for item in missing)
        return 'cannot_tell' if is_ambiguous else 'effect_found'
    if not fit.fits or uneven is not None:
        return 'cannot_tell'
    basic = [name for name, effect in EFFECTS.items() if shows_in_any_turns(effect)]
    judged = [name for name in basic if name not in not_judged]
    return 'nothing_missing' if len(judged) >= settings.min_judgeable_part * len(basic) else 'cannot_tell'


def _outweighs(
    left: UnexplainedStructure, missing: list[MissingEffect], fit: ModelFit, settings: DiagnosisSettings
) -> bool:
    """Return True if what is left is more than the effects found leave by being inexact."""
    is_contradicted = left.is_confirmed and fit.fits is False
    return is_contradicted or left.gain > settings.leftover_part * sum(item.gain for item in missing)


def _not_judged(examined: ExaminedModel, recording: RecordingSummary) -> Iterator[tuple[str, str]]:
    present = {effect.name for effect in examined.model.effects}
    for name, effect in EFFECTS.items():
        if name in present or not is_estimated(effect):
            continue
        reason, judged = why_unobservable(effect, recording), examined.find(name)
        if reason:
            yield name, reason
        elif name in examined.disturbed:
            yield name, examined.disturbed[name]
        elif judged is None:
            yield name, 'nothing in this recording depends on it'
        elif not (judged.could_show or judged.is_significant):
            yield name, 'even one of usual size would not show in this recording'
    for name in recording.left_out:
        yield name, 'more signals are recorded than can be tried'
