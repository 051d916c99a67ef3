"""The search for what a model lacks: run the filter, add the best explanation, run it again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.candidates import candidates_for
from gyrocal_ros.diagnose.drift import drift_of_both_deg
from gyrocal_ros.diagnose.heading_filter import Headings, headings
from gyrocal_ros.diagnose.limits import Competition, LimitProposal, detected_limits, propose_limits
from gyrocal_ros.diagnose.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.ranking import (
    RankedEffect,
    best_explanation,
    estimate_stds,
    indistinguishable,
    rank,
    with_estimate,
)
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.diagnose.shapes import UnexplainedStructure, confirmed, unexplained_structure
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import is_limit, may_break_the_filter, strengths
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import ScoreStatistics
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.statistics import chi_square_tail, sigma_of, vuong_sigma

NONE: IntArray = np.empty(0, np.int64)
Calibrate = Callable[[SensorModel, tuple[Effect, ...]], Run]
"""Runs the filter with a model and with candidate effects."""
MAX_ADDITIONS = 3
"""Number of effects that a search tries to add."""


@dataclass(frozen=True, slots=True, eq=False)
class ExaminedModel:
    """One model on a recording, and what the recording says that it lacks."""

    model: SensorModel
    run: Run
    scores: ScoreStatistics
    ranked: tuple[RankedEffect, ...]
    """Candidate effects, the best first."""
    seen: Headings
    unexplained_structure: UnexplainedStructure | None
    """Structure left over as a function of something recorded; None where it may be chance."""
    settings: DiagnosisSettings

    def find(self, name: str) -> RankedEffect | None:
        """Return the candidate of that name."""
        return next((item for item in self.ranked if item.effect.name == name), None)


@dataclass(frozen=True, slots=True, eq=False)
class Addition:
    """An effect that was added to the model."""

    effect: Effect
    """The effect with the prior that it was added with."""
    before: ExaminedModel | None
    """None where the filter could not run without it."""
    after: ExaminedModel
    gain: float
    """Log-likelihood that the score statistics predicted; for a limit, what the run gained."""
    sigma: float
    p_value: float
    stds: Array
    """(k,) standard deviations by the scatter over the recording, zero where none was estimated."""
    strengths: IntArray
    """(q,) indices of the coefficients that say how strong it is; not a limit or a time constant."""
    outperformed: tuple[str, ...] = ()
    """Effects that looked like it, until a run with each predicted the recording clearly worse."""
    is_rejected: bool = False
    """True for a learned effect with which the recording is not predicted better, or drifts more."""

    @property
    def predictive_gain(self) -> float:
        """Predictive log-likelihood gained over the model before."""
        return (
            math.inf if self.before is None else float(predictive_gain(self.before.run, self.after.run).sum())
        )

    @property
    def stands_out(self) -> bool:
        """True if any of its strengths is clear of zero once all others are estimated beside it."""
        if not len(self.strengths):
            return True
        places = self.strengths - len(self.effect.coefficients)
        values, stds = self.after.run.state.coefficients, self.after.run.history.std[-1]
        std = np.maximum(stds[places], self.stds[self.strengths])
        return bool(np.any(np.abs(values[places]) > self.after.settings.nonzero_sigma * std))

    @property
    def is_kept(self) -> bool:
        """True if the recording is predicted better with the effect, not zero, and drifts no more."""
        predicts = self.predictive_gain > self.after.settings.min_predictive_gain
        return predicts and self.stands_out and not self.is_rejected and not self.raises_drift

    @property
    def raises_drift(self) -> bool:
        """True if the held-out drift rises with the effect by more than chance does where it is harmless."""
        if self.before is None:
            return False
        before_deg, after_deg = drift_of_both_deg(self.before.run, self.after.run)
        return after_deg > self.after.settings.max_drift_rise * before_deg


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A finished search."""

    first: ExaminedModel
    additions: tuple[Addition, ...]
    """Kept and rejected ones, in the order in which they were tried."""

    @property
    def kept(self) -> tuple[Addition, ...]:
        """Additions that helped."""
        return tuple(item for item in self.additions if item.is_kept)

    @property
    def last(self) -> ExaminedModel:
        """The model with all additions that helped."""
        return self.kept[-1].after if self.kept else self.first


def search(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int = MAX_ADDITIONS,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Search:
    """Find what a model lacks.

    Args:
        model: the present sensor model.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try. Each needs one run of the filter; further runs are the first one,
            and one for each effect that looks like the last one found.
        settings: thresholds.

    Raises:
        FilterDivergedError: the filter cannot run with this model.
    """
    additions: list[Addition] = []
    try:
        first = present = examine(model, recording, calibrate, settings)
    except FilterDivergedError:
        recovered = recover(model, recording, calibrate, settings)
        if recovered is None:
            raise
        additions.append(recovered)
        first = present = recovered.after
    additions = continued(additions, present, recording, calibrate, most)
    last = next((item for item in reversed(additions) if item.is_kept), None)
    if last is not None:
        better = _contested(last, recording, calibrate, {item.effect.name for item in additions})
        place = additions.index(last)
        if better.effect.name == last.effect.name:
            additions[place] = better
        else:
            additions = continued([*additions[:place], better], better.after, recording, calibrate, most)
    return Search(first, tuple(additions))


def try_effect(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    effect: Effect,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Search:
    """Add one effect, whatever the recording says of it.

    Raises:
        FilterDivergedError: the filter cannot run with this model, or not with the effect.
    """
    first = examine(model, recording, calibrate, settings)
    after = examine(wider_model(first, effect), recording, calibrate, settings)
    return Search(first, (addition(first, after),))


def examine(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> ExaminedModel:
    """Run the filter with a model and with everything else as candidates."""
    candidates = candidates_for(model, recording)
    run = calibrate(model, candidates.carried)
    assert run.scores is not None
    scores, seen = candidates.project(run.scores), headings(run, settings)
    ranked = tuple(rank(scores, settings))
    most_gained = max((item.fit.gain for item in ranked), default=0.0)
    structure = confirmed(unexplained_structure(run, seen, settings), most_gained, settings)
    return ExaminedModel(model, run, scores, ranked, seen, structure, settings)


def wider_model(present: ExaminedModel, effect: Effect) -> SensorModel:
    """Return the model with one more effect, its prior by the score statistics where there are any."""
    found = present.find(effect.name)
    if found is not None:
        effect = with_estimate(found, present.scores, present.settings)
    return with_effect(present.model, effect)


def with_effect(model: SensorModel, effect: Effect) -> SensorModel:
    """Return the next version of the model, with one more effect."""
    return replace(model, effects=(*model.effects, effect), version=model.version + 1)


def addition(before: ExaminedModel, after: ExaminedModel) -> Addition:
    """Describe the last effect of the model `after`, which is not in the model before."""
    effect = after.model.effects[-1]
    found = before.find(effect.name)
    if found is None:
        return Addition(effect, before, after, 0.0, 0.0, 1.0, np.zeros(len(effect.coefficients)), NONE)
    return Addition(
        effect=effect,
        before=before,
        after=after,
        gain=found.fit.gain,
        sigma=found.fit.sigma,
        p_value=found.fit.p_value,
        stds=estimate_stds(found),
        strengths=found.places,
    )


def limits_to_check(
    present: ExaminedModel, recording: RecordingSummary, best: RankedEffect | None
) -> list[LimitProposal]:
    """Return limits that the readings suggest, beside the best explanation of another kind."""
    structure = present.unexplained_structure
    others = Competition(
        structure_gain=structure.gain if structure is not None else 0.0,
        rival_gain=best.fit.gain if best is not None else 0.0,
        has_jumped=structure is not None and structure.at_s is not None,
    )
    return list(propose_limits(present.run, present.seen, recording.readings, others, present.settings))


def recover(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Addition | None:
    """Find the effect whose absence makes the filter diverge: the one with which it runs best, or None."""
    present = {effect.name for effect in model.effects}
    others = [item for item in EFFECTS.values() if may_break_the_filter(item) and not is_limit(item)]
    likelihoods: dict[float, Effect] = {}
    for effect in [*detected_limits(model, recording.readings), *others]:
        if effect.name in present:
            continue
        with suppress(FilterDivergedError):
            history = calibrate(with_effect(model, effect), ()).history
            likelihoods[float(history.log_likelihood.sum() / history.dof.sum())] = effect
    if not likelihoods:
        return None
    effect = likelihoods[max(likelihoods)]
    after = examine(with_effect(model, effect), recording, calibrate, settings)
    stds = np.zeros(len(effect.coefficients))
    return Addition(effect, None, after, math.inf, math.inf, 0.0, stds, strengths(effect))


def continued(
    additions: Sequence[Addition],
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> list[Addition]:
    """Add one effect after the other, until nothing more is found or enough were tried."""
    found = [*additions]
    while len(found) < most:
        tried = {item.effect.name for item in found}
        gained = sum(item.gain for item in found if item.is_kept and math.isfinite(item.gain))
        following = _next_addition(
            present, recording, calibrate, tried, present.settings.residual_part * gained
        )
        if following is None:
            break
        found.append(following)
        if following.is_kept:
            present = following.after
    return found


def _next_addition(
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    tried: set[str],
    least_gain: float,
) -> Addition | None:
    """Add the best explanation, unless nothing is missing or nothing known explains it."""
    settings = present.settings
    best = best_explanation(present.ranked, present.scores, tried, settings)
    if best is not None and best.fit.gain < least_gain:
        best = None
    rival_gain = best.fit.gain if best is not None else 0.0
    structure = present.unexplained_structure
    structure_gain = structure.gain if structure is not None else 0.0
    limits = [item for item in limits_to_check(present, recording, best) if item.effect.name not in tried]
    for limit in (item for item in limits if item.is_certain):
        limited = _limited(present, limit.effect, recording, calibrate, settings.min_predictive_gain)
        if limited is not None:
            return limited
    is_known = best is not None and structure_gain <= settings.structure_margin * rival_gain
    rival = None
    if best is not None and is_known:
        with suppress(FilterDivergedError):
            wider = wider_model(present, best.effect)
            rival = addition(present, examine(wider, recording, calibrate, settings))
    # The process noise of a limit improves any model, so a limit has to beat a run with the best effect.
    explained = structure_gain if rival is None else rival.predictive_gain
    at_least = max(settings.limit_margin * explained, settings.min_predictive_gain)
    for limit in (item for item in limits if not item.is_certain):
        limited = _limited(present, limit.effect, recording, calibrate, at_least)
        if limited is not None:
            return limited
    return rival


def _limited(
    present: ExaminedModel,
    limit: Effect,
    recording: RecordingSummary,
    calibrate: Calibrate,
    least_gain: float,
) -> Addition | None:
    """Add a limit, if a run with it gains enough predictive log-likelihood."""
    model, settings = with_effect(present.model, limit), present.settings
    try:
        gain = float(predictive_gain(present.run, calibrate(model, ())).sum())
        if gain < least_gain:
            return None
        after = examine(model, recording, calibrate, settings)
    except FilterDivergedError:
        return None
    p_value = chi_square_tail(2.0 * gain / settings.min_inflation, 1)
    return Addition(limit, present, after, gain, sigma_of(p_value), p_value, np.zeros(1), NONE)


def _contested(
    last: Addition, recording: RecordingSummary, calibrate: Calibrate, tried: set[str]
) -> Addition:
    """Return the last addition, or an effect that looks like it if a run with that predicts clearly better.

    To first order the wrong effect may look like the true one, and even a little better; not in a run.
    """
    if last.before is None:
        return last
    settings = last.before.settings
    additions = [last]
    for rival in _rivals(last.before, last.effect.name, tried):
        with suppress(FilterDivergedError):
            wider = wider_model(last.before, rival.effect)
            additions.append(addition(last.before, examine(wider, recording, calibrate, settings)))
    best = max((item for item in additions if item.is_kept), key=lambda item: item.predictive_gain)
    if best.predictive_gain <= last.predictive_gain + settings.min_predictive_gain:
        best = last
    outperformed = (
        item.effect.name
        for item in additions
        if item is not best
        and vuong_sigma(predictive_gain(item.after.run, best.after.run)) > settings.indistinguishable_sigma
    )
    return replace(best, outperformed=tuple(outperformed))


def _rivals(present: ExaminedModel, name: str, tried: set[str]) -> list[RankedEffect]:
    """Return untried effects that look like one of that name, the likeliest first.

    Effects with a scan are left out: the filter finds a time constant only from nearby, so a run is no fair
    test of them.
    """
    found = present.find(name)
    if found is None or found.profile is not None:
        return []
    others = [item for item in present.ranked if item.effect.name not in tried and item.profile is None]
    names = set(indistinguishable(found, others, present.scores, NONE, present.settings))
    return [item for item in others if item.effect.name in names][: present.settings.max_rivals]
