"""The search for what a model lacks: look, add the best explanation, look again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.candidate_fit import chi_square_tail, sigma_of
from gyrocal_ros.diagnose.candidates import candidate_set
from gyrocal_ros.diagnose.heading_filter import Headings, headings
from gyrocal_ros.diagnose.limits import LimitProposal, pile, proposals, with_limit
from gyrocal_ros.diagnose.predictive_gain import predictive_gain, vuong_sigma
from gyrocal_ros.diagnose.ranking import (
    TWIN_SIGMA,
    RankedEffect,
    best_explanation,
    doubts,
    rank,
    twins,
    with_estimate,
)
from gyrocal_ros.diagnose.recorded import Recorded
from gyrocal_ros.diagnose.shapes import INFLATION, UnexplainedStructure, unexplained_structure
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import ScoreStatistics
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import Effect, SensorModel

NONE: IntArray = np.empty(0, np.int64)
Calibrate = Callable[[SensorModel, tuple[Effect, ...]], Run]
"""Runs the filter with a model and with candidates on trial."""

RESCUERS = (
    'camera_tilt',
    'camera_time_offset',
    'principal_point',
    'focal_length',
    'radial_distortion',
    'gyro_lag',
)
"""Effects that may be so large that the filter cannot run without them."""
ODD_PART = 1.25
"""Something unknown has to explain so many times what the best effect of the library explains."""
SHOWN_PART, SHOWN_GAIN = 0.1, 40.0
"""So much of something unknown, or as much log-likelihood, has to show in some effect of the library."""
LIMIT_PART = 1.05
"""A limit, which makes the filter doubt its gyro, has to explain more than any other effect by this."""
STANDS_OUT = 3.0
"""Standard deviations that a coefficient has to be away from zero in the end."""
BESIDES = 0.004
"""What explains less than this part of what was found before is due to that not being exact."""
MIN_FORESEEN = 3.0
"""Log-likelihood by which a recording has to be foreseen better for an effect to be kept: odds of 20."""

RIVALS = 2
"""So many effects that look like the best one are given a run of their own."""


@dataclass(frozen=True, slots=True, eq=False)
class ExaminedModel:
    """One model on a recording, and what the recording says that it lacks."""

    model: SensorModel
    run: Run
    scores: ScoreStatistics
    ranked: tuple[RankedEffect, ...]
    """The best first."""
    seen: Headings
    unexplained_structure: UnexplainedStructure | None
    """What is left over as a function of something recorded, where it is more than chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Addition:
    """An effect that was put into the model."""

    effect: Effect
    """Its prior means are what the evidence said of it before it was put in."""
    before: ExaminedModel | None
    """None where the filter could not run without it."""
    after: ExaminedModel
    gain: float
    """Log-likelihood that the evidence promised; for a limit, what the run gained."""
    sigma: float
    p_value: float
    stds: Array
    """(k,) of the coefficients by the scatter over the recording, zero where none was estimated."""
    strengths: IntArray
    """(q,) which coefficients say how strong it is; a limit or a time constant does not."""
    outdone: tuple[str, ...] = ()
    """Effects that looked like it, until a run with each foresaw the recording clearly worse."""

    @property
    def predictive_gain(self) -> float:
        """Log-likelihood of each measurement, given those before it, that the effect gained."""
        return (
            math.inf if self.before is None else float(predictive_gain(self.before.run, self.after.run).sum())
        )

    @property
    def stands_out(self) -> bool:
        """Whether any of its coefficients is clear of zero once all others are estimated beside it."""
        if not len(self.strengths):
            return True
        places = self.strengths - len(self.effect.coefficients)
        values, stds = self.after.run.state.coefficients, self.after.run.history.std[-1]
        doubt = np.maximum(stds[places], self.stds[self.strengths])
        return bool(np.any(np.abs(values[places]) > STANDS_OUT * doubt))

    @property
    def is_kept(self) -> bool:
        """Whether the recording was foreseen better with the effect than without, and it is there at all."""
        return self.predictive_gain > MIN_FORESEEN and self.stands_out


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A finished search."""

    first: ExaminedModel
    changes: tuple[Addition, ...]
    """Kept and rejected ones, in the order in which they were tried."""

    @property
    def kept(self) -> tuple[Addition, ...]:
        """Those that helped."""
        return tuple(change for change in self.changes if change.is_kept)

    @property
    def last(self) -> ExaminedModel:
        """With all that helped."""
        return self.kept[-1].after if self.kept else self.first


def search(model: SensorModel, recorded: Recorded, calibrate: Calibrate, most: int = 3) -> Search:
    """Find what a model lacks.

    Args:
        model: the present sensor model.
        recorded: what the recording offers.
        calibrate: runs the filter.
        most: effects to try; one run of the filter each, one before, and one for each that looks like the
            last.

    Raises:
        FilterDivergedError: the filter cannot run with this model.
    """
    changes: list[Addition] = []
    try:
        first = stage = examine(model, recorded, calibrate)
    except FilterDivergedError:
        rescued = recover(model, recorded, calibrate)
        if rescued is None:
            raise
        changes.append(rescued)
        first = stage = rescued.after
    changes = _continued(changes, stage, recorded, calibrate, most)
    last = next((change for change in reversed(changes) if change.is_kept), None)
    if last is not None:
        better = _contested(last, recorded, calibrate, {change.effect.name for change in changes})
        place = changes.index(last)
        if better.effect.name == last.effect.name:
            changes[place] = better
        else:
            changes = _continued([*changes[:place], better], better.after, recorded, calibrate, most)
    return Search(first, tuple(changes))


def _continued(
    changes: list[Addition], stage: ExaminedModel, recorded: Recorded, calibrate: Calibrate, most: int
) -> list[Addition]:
    """Put in one effect after the other, until nothing more is found or so many were tried."""
    changes = [*changes]
    while len(changes) < most:
        tried = {change.effect.name for change in changes}
        least_gain = BESIDES * sum(item.gain for item in changes if item.is_kept and math.isfinite(item.gain))
        change = _next_change(stage, recorded, calibrate, tried, least_gain)
        if change is None:
            break
        changes.append(change)
        if change.is_kept:
            stage = change.after
    return changes


def trial(model: SensorModel, recorded: Recorded, calibrate: Calibrate, effect: Effect) -> Search:
    """Try one effect, whatever the recording says of it.

    Raises:
        FilterDivergedError: the filter cannot run with this model, or not with the effect.
    """
    first = examine(model, recorded, calibrate)
    return Search(first, (change_made(first, examine(wider_model(first, effect), recorded, calibrate)),))


def wider_model(stage: ExaminedModel, effect: Effect) -> SensorModel:
    """The model of a stage with one more effect, expected where its evidence puts it."""
    ranked_effect = _suspect(stage, effect.name)
    return with_effect(
        stage.model, effect if ranked_effect is None else with_estimate(ranked_effect, stage.scores)
    )


def change_made(before: ExaminedModel, after: ExaminedModel) -> Addition:
    """What the last effect of the model `after` changed, which is not in the model before."""
    effect = after.model.effects[-1]
    ranked_effect = _suspect(before, effect.name)
    if ranked_effect is None:
        return Addition(effect, before, after, 0.0, 0.0, 1.0, np.zeros(len(effect.coefficients)), NONE)
    return Addition(
        effect=effect,
        before=before,
        after=after,
        gain=ranked_effect.fit.gain,
        sigma=ranked_effect.fit.sigma,
        p_value=ranked_effect.fit.p_value,
        stds=doubts(ranked_effect),
        strengths=ranked_effect.places,
    )


def _suspect(stage: ExaminedModel, name: str) -> RankedEffect | None:
    return next((item for item in stage.ranked if item.effect.name == name), None)


def examine(model: SensorModel, recorded: Recorded, calibrate: Calibrate) -> ExaminedModel:
    """Run the filter with a model, everything else on trial."""
    trials = candidate_set(model, recorded)
    run = calibrate(model, trials.carried)
    assert run.scores is not None
    scores, seen = trials.judged(run.scores), headings(run)
    ranked = tuple(rank(scores))
    return ExaminedModel(model, run, scores, ranked, seen, _shown(unexplained_structure(run, seen), ranked))


def _shown(odd: UnexplainedStructure | None, ranked: Sequence[RankedEffect]) -> UnexplainedStructure | None:
    """An oddity that the whole filter sees too: some effect or other then explains a part of it.

    The headings alone know nothing of the map's own errors, which come and go with its features.
    """
    if odd is None:
        return None
    most = max((ranked_effect.fit.gain for ranked_effect in ranked), default=0.0)
    return odd if most >= min(SHOWN_PART * odd.gain, SHOWN_GAIN) else None


def with_effect(model: SensorModel, effect: Effect) -> SensorModel:
    """The next version of the model, with one more effect."""
    return replace(model, effects=(*model.effects, effect), version=model.version + 1)


def suspected_limits(
    stage: ExaminedModel, recorded: Recorded, best: RankedEffect | None
) -> list[LimitProposal]:
    """Limits that the readings suggest, beside the best explanation of another kind."""
    odd = stage.unexplained_structure
    return list(
        proposals(
            stage.run,
            stage.seen,
            recorded,
            odd_gain=odd.gain if odd is not None else 0.0,
            rival_gain=best.fit.gain if best is not None else 0.0,
            has_jumped=odd is not None and odd.at_s is not None,
        )
    )


def _next_change(
    stage: ExaminedModel, recorded: Recorded, calibrate: Calibrate, tried: set[str], least_gain: float
) -> Addition | None:
    """Put the best explanation into the model, unless nothing is missing or nothing known explains it."""
    best = best_explanation(stage.ranked, stage.scores, tried)
    if best is not None and best.fit.gain < least_gain:
        best = None
    rival_gain = best.fit.gain if best is not None else 0.0
    odd_gain = stage.unexplained_structure.gain if stage.unexplained_structure is not None else 0.0
    limits = [limit for limit in suspected_limits(stage, recorded, best) if limit.effect.name not in tried]
    for limit in (limit for limit in limits if limit.is_read):
        change = _limited(stage, limit.effect, recorded, calibrate, MIN_FORESEEN)
        if change is not None:
            return change
    is_known = best is not None and odd_gain <= ODD_PART * rival_gain
    rival = None
    if best is not None and is_known:
        with suppress(FilterDivergedError):
            rival = change_made(stage, examine(wider_model(stage, best.effect), recorded, calibrate))
    # A limit makes the filter doubt its gyro, which helps against anything: it has to beat a run, too.
    at_least = max(LIMIT_PART * (odd_gain if rival is None else rival.predictive_gain), MIN_FORESEEN)
    for limit in (limit for limit in limits if not limit.is_read):
        change = _limited(stage, limit.effect, recorded, calibrate, at_least)
        if change is not None:
            return change
    return rival


def _contested(change: Addition, recorded: Recorded, calibrate: Calibrate, tried: set[str]) -> Addition:
    """The last effect found, or one that looks like it where a run with that foresees clearly more.

    To first order the wrong effect may look like the true one, and even a little better; not in a run.
    """
    if change.before is None:
        return change
    changes = [change]
    for rival in _rivals(change.before, change.effect.name, tried):
        with suppress(FilterDivergedError):
            after = examine(wider_model(change.before, rival.effect), recorded, calibrate)
            changes.append(change_made(change.before, after))
    best = max((item for item in changes if item.is_kept), key=lambda item: item.predictive_gain)
    if best.predictive_gain <= change.predictive_gain + MIN_FORESEEN:
        best = change
    outdone = (
        item.effect.name
        for item in changes
        if item is not best and vuong_sigma(predictive_gain(item.after.run, best.after.run)) > TWIN_SIGMA
    )
    return replace(best, outdone=tuple(outdone))


def _rivals(stage: ExaminedModel, name: str, tried: set[str]) -> list[RankedEffect]:
    """Effects not tried yet that look like one of that name, the likeliest first.

    Not where a time constant is to be found: the filter finds it only from near, so a run is no fair test.
    """
    ranked_effect = _suspect(stage, name)
    if ranked_effect is None or ranked_effect.profile is not None:
        return []
    others = [item for item in stage.ranked if item.effect.name not in tried and item.profile is None]
    names = set(twins(ranked_effect, others, stage.scores, NONE))
    return [item for item in others if item.effect.name in names][:RIVALS]


def _limited(
    stage: ExaminedModel, limit: Effect, recorded: Recorded, calibrate: Calibrate, least_gain: float
) -> Addition | None:
    """Put a limit into the model, if a run with it foresees the recording so much better."""
    model = with_effect(stage.model, limit)
    try:
        gain = float(predictive_gain(stage.run, calibrate(model, ())).sum())
        if gain < least_gain:
            return None
        after = examine(model, recorded, calibrate)
    except FilterDivergedError:
        return None
    p_value = chi_square_tail(2.0 * gain / INFLATION, 1)
    return Addition(limit, stage, after, gain, sigma_of(p_value), p_value, np.zeros(1), NONE)


def recover(model: SensorModel, recorded: Recorded, calibrate: Calibrate) -> Addition | None:
    """Where the filter cannot run, one effect may be why: that with which it runs best.

    None where there is no such effect.
    """
    present = {effect.name for effect in model.effects}
    limit = pile(recorded)
    limits = [] if limit is None else [with_limit('rate_saturation', limit)]
    rescuers: list[Effect] = [*limits, *(EFFECTS[name] for name in RESCUERS)]
    likelihoods: dict[float, Effect] = {}
    for effect in (effect for effect in rescuers if effect.name not in present):
        try:
            history = calibrate(with_effect(model, effect), ()).history
        except FilterDivergedError:
            continue
        likelihoods[float(history.log_likelihood.sum() / history.dof.sum())] = effect
    if not likelihoods:
        return None
    effect = likelihoods[max(likelihoods)]
    after = examine(with_effect(model, effect), recorded, calibrate)
    count = len(effect.coefficients)
    strengths = NONE if effect in limits else np.arange(count)
    return Addition(effect, None, after, math.inf, math.inf, 0.0, np.zeros(count), strengths)
