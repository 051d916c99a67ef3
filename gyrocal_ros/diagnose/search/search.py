"""The search for what a model lacks: run the filter, add the best explanation, run it again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, coefficient_places, examine
from gyrocal_ros.diagnose.analysis.model_fit import model_fit
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.ranking import (
    RankedEffect,
    best_explanation,
    explained_together,
    indistinguishable,
)
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.analysis.shapes import unexplained_structure
from gyrocal_ros.diagnose.search.additions import (
    IMPOSSIBLE_SIGN,
    NONE,
    Addition,
    Search,
)
from gyrocal_ros.diagnose.search.limit_runs import (
    explains_most,
    limit_instead_of_timing,
    limits_to_check,
    tried_limit,
    tried_limits,
    with_limit,
)
from gyrocal_ros.diagnose.search.limit_sizes import resized
from gyrocal_ros.diagnose.search.noise_fit import unless_a_walk_explains
from gyrocal_ros.diagnose.search.one_more import each_one_more, with_one_more
from gyrocal_ros.diagnose.search.recovery import first_run
from gyrocal_ros.diagnose.search.thermometer import or_by_temperature
from gyrocal_ros.diagnose.search.timing import timing_fault
from gyrocal_ros.diagnose.search.traces import best_beside, traces
from gyrocal_ros.diagnose.search.uneven import uneven_addition, uneven_explanation
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.effects.traits import is_estimated
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, LimitEffect, SensorModel, with_means
from gyrocal_ros.statistics import vuong_sigma

MAX_ADDITIONS = 6
"""Number of effects that a search tries to add."""
DRIFT_BY_NOISE = 1.2
"""Held-out drift, relative to what noise explains, up to which noise explains all of it."""
MAX_TRIES = 2
"""Number of times that one effect is tried: one that was rejected may help beside others found since."""
NEARLY = 0.9
"""Part of the gain of an effect with an impossible sign that another effect has to have to take its place."""


def search(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int = MAX_ADDITIONS,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Search:
    """Find what a model lacks; see `search_from`.

    Args:
        model: the present sensor model.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of effects to try, each in a run; those that look like the last one found add runs.
        settings: thresholds.

    Raises:
        FilterDivergedError: the filter cannot run with this model.
    """
    return search_from(*first_run(model, recording, calibrate, settings), recording, calibrate, most)


def search_from(
    first: ExaminedModel,
    additions: list[Addition],
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
) -> Search:
    """Find what a model lacks beside what it was given to run at all, see `recovery.first_run`.

    Where the stamps are at fault only limits are tried: other effects would gain, and none would be right.
    """
    present = first
    if timing_fault(present) is not None:
        limited = limit_instead_of_timing(present, recording, calibrate)
        if limited is None:
            return Search(first, tuple(additions))
        additions.append(limited)
        present = limited.after
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
    return Search(first, (with_one_more(first, effect, recording, calibrate),))


def continued(
    additions: Sequence[Addition],
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    most: int,
    without: frozenset[str] = frozenset(),
    is_beaten: Callable[[ExaminedModel], bool] = lambda present: False,
) -> list[Addition]:
    """Add one effect after the other, until nothing more is found or enough were tried.

    Coefficients that were inexact at the start leave errors that look like further effects, and spoil the
    scatter that judges weak ones. Before one that gains little is tried, the filter runs from the estimates.

    Args:
        additions: what was added before.
        present: the model with it.
        recording: summary of the recording.
        calibrate: runs the filter.
        most: number of additions in all.
        without: names of effects that are not to be tried.
        is_beaten: says of a model with which nothing more is significant that no trifle can save it.
    """
    found = [*additions]
    is_exact = False
    while len(found) < most:
        least_gain = 0.0 if is_exact else _residual_gain(found, present.settings)
        excluded = _not_to_try(found) | without
        following = _next_addition(present, recording, calibrate, excluded, least_gain, traces(found))
        is_first = not any(item.is_kept for item in found)
        if following is None and is_beaten(present):
            break
        if following is None and (is_exact or is_first):
            following = uneven_addition(present, recording, calibrate, excluded, is_first=is_first)
        if following is not None:
            if following.is_kept and following.is_impossible:
                following = _contested(following, recording, calibrate, set())
            following = _with_limits_resized(following, found, recording, calibrate)
            found.append(following)
            if following.is_kept:
                present, is_exact = following.after, False
            continue
        added = {item.effect.name for item in found if item.is_kept}
        if is_exact or not added or not _hints_at_more(present, excluded):
            break
        present, is_exact = _relinearised(present, added, recording, calibrate), True
    return found


def _hints_at_more(present: ExaminedModel, excluded: set[str]) -> bool:
    """Return True if another effect gains, evenly or not."""
    ranked, settings = present.ranked, present.settings
    best = best_explanation(ranked, present.scores, excluded, settings)
    return best is not None or uneven_explanation(ranked, excluded, settings) is not None


def _with_limits_resized(
    added: Addition, found: Sequence[Addition], recording: RecordingSummary, calibrate: Calibrate
) -> Addition:
    """Fit limits that were found before an effect again beside it."""
    limits = {item.effect.name for item in found if item.is_kept and isinstance(item.effect, LimitEffect)}
    if not limits or not added.is_kept:
        return added
    better = replace(added, after=resized(added.after, limits, recording, calibrate))
    return better if better.is_kept else added


def _residual_gain(found: Sequence[Addition], settings: DiagnosisSettings) -> float:
    """Return the log-likelihood that an effect may gain because those found were not quite exact."""
    gained = sum(item.gain for item in found if item.is_kept and math.isfinite(item.gain))
    return settings.residual_part * gained


def _not_to_try(found: Sequence[Addition]) -> set[str]:
    """Return the names of effects that were rejected beside the present model, or too often."""
    kept = [place for place, item in enumerate(found) if item.is_kept]
    tried = Counter(item.effect.name for item in found)
    since = {item.effect.name for item in found[kept[-1] if kept else 0 :]}
    return since | {name for name, count in tried.items() if count >= MAX_TRIES}


def _relinearised(
    present: ExaminedModel, added: set[str], recording: RecordingSummary, calibrate: Calibrate
) -> ExaminedModel:
    """Run the filter again, with the effects that were added starting at their estimates of half time.

    The second half remains a test of them. Returns the present model where the filter diverges.
    """
    history = present.run.history
    half = int(np.searchsorted(history.time_s, 0.5 * history.time_s[-1]))
    values = history.coefficients[half]
    effects = tuple(
        with_means(effect, values[coefficient_places(present.model, effect.name)].tolist())
        if effect.name in added and is_estimated(effect)
        else effect
        for effect in present.model.effects
    )
    with suppress(*CANNOT_RUN):
        return examine(replace(present.model, effects=effects), recording, calibrate, present.settings)
    return present


def _next_addition(
    present: ExaminedModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    excluded: set[str],
    least_gain: float,
    beside: set[str],
) -> Addition | None:
    """Add the best explanation, unless nothing is missing or nothing known explains it.

    Args:
        present: the model so far.
        recording: summary of the recording.
        calibrate: runs the filter.
        excluded: names of effects not to try.
        least_gain: log-likelihood that an effect has to gain.
        beside: names of traces, beside which it has to be significant.
    """
    settings = present.settings
    best = best_beside(present, excluded, beside)
    if best is not None and best.fit.gain < least_gain:
        best = None
    structure = present.unexplained_structure
    structure_gain = structure.gain if structure is not None else 0.0
    limits = [item for item in limits_to_check(present, recording, best) if item.effect.name not in excluded]
    for effect in (item.effect for item in limits if item.is_certain):
        sized, gain = tried_limit(present, effect, recording, calibrate)
        if gain >= settings.min_predictive_gain:
            limited = with_limit(present, sized, recording, calibrate)
            if limited is not None:
                return limited
    known_gain = explained_together(present.ranked, present.scores, settings)
    is_strange = structure_gain > settings.structure_margin * known_gain
    rival = None if best is None else _with_best(present, best, recording, calibrate, excluded, is_strange)
    # The process noise of a limit improves any model, so it has to beat a run with the best effect. Where
    # there is none, the limit has to explain most of what is wrong.
    rival_gain = 0.0 if rival is None else rival.predictive_gain
    alike = []
    uncertain = [item.effect for item in limits if not item.is_certain]
    for sized, gain in tried_limits(present, uncertain, recording, calibrate):
        if gain >= rival_gain + settings.limit_margin:
            limited = with_limit(present, sized, recording, calibrate)
            if limited is not None and (rival is not None or explains_most(limited)):
                return limited
        elif gain >= settings.limit_alike_part * rival_gain:
            alike.append(sized.name)
    if rival is None:
        return None
    return unless_a_walk_explains(replace(rival, alike=tuple(dict.fromkeys(alike))))


def _with_best(
    present: ExaminedModel,
    best: RankedEffect,
    recording: RecordingSummary,
    calibrate: Calibrate,
    excluded: set[str],
    is_strange: bool,
) -> Addition | None:
    """Add the best explanation.

    Structure that gains more than all effects together may still be one of them, for the headings alone and
    the full filter weigh it differently. Then the first effect that leaves little of it in a run is added.
    """
    if not is_strange:
        with suppress(*CANNOT_RUN):
            added = with_one_more(present, best.effect, recording, calibrate)
            return or_by_temperature(added, excluded, recording, calibrate)
        return None
    others = [item for item in present.ranked if item.is_significant and item.effect.name not in excluded]
    for item in [best, *(item for item in others if item is not best)][: 1 + present.settings.max_rivals]:
        with suppress(*CANNOT_RUN):
            added = with_one_more(present, item.effect, recording, calibrate)
            if _explains_structure(added):
                return added
    return None


def _explains_structure(added: Addition) -> bool:
    """Return True if a run with an effect leaves little of the unexplained structure, or only noise.

    The headings of a robot whose map is uncertain for long contain structure of the map.
    """
    assert added.before is not None and added.before.unexplained_structure is not None
    after, settings = added.after, added.after.settings
    judged = model_fit(after.run)
    if judged.fits and judged.drift_ratio <= DRIFT_BY_NOISE:
        return True
    left = unexplained_structure(after.run, after.seen, settings)
    return left is None or left.gain <= settings.leftover_part * added.before.unexplained_structure.gain


def _contested(
    last: Addition, recording: RecordingSummary, calibrate: Calibrate, tried: set[str]
) -> Addition:
    """Return the last addition, or an effect that looks like it if a run with that predicts clearly better.

    To first order the wrong effect may look like the true one, and even a little better; not in a run. Where
    a few moments make the run better, it says nothing: then both stay indistinguishable. One with a sign that
    is impossible gives way to one that is nearly as good; without one it is rejected.
    """
    if last.before is None:
        return last
    settings = last.before.settings
    excluded = {last.effect.name} if last.is_impossible else tried
    part = NEARLY if last.is_impossible else math.inf
    rivals = [item.effect for item in _rivals(last.before, last.effect.name, excluded, part)]
    additions = [last, *each_one_more(last.before, rivals, recording, calibrate)]
    best, best_gain = last, settings.min_predictive_gain
    for item in additions[1:]:
        gains = predictive_gain(last.after.run, item.after.run)
        if item.is_kept and vuong_sigma(gains) > settings.rival_sigma and gains.sum() > best_gain:
            best, best_gain = item, float(gains.sum())
    if best.is_impossible:
        impossible = replace(best, objection=IMPOSSIBLE_SIGN)
        best = next((item for item in additions if _is_as_good(item, best)), impossible)
    outperformed = (
        item.effect.name
        for item in additions
        if item is not best
        and vuong_sigma(predictive_gain(item.after.run, best.after.run)) > settings.indistinguishable_sigma
    )
    return replace(best, outperformed=tuple(outperformed))


def _is_as_good(item: Addition, best: Addition) -> bool:
    """Return True if an addition is possible and predicts as well as the best one, nearly or by chance."""
    lost = vuong_sigma(predictive_gain(item.after.run, best.after.run))
    is_close = item.predictive_gain > NEARLY * best.predictive_gain
    is_close = is_close or lost <= item.after.settings.indistinguishable_sigma
    return item.is_kept and not item.is_impossible and is_close


def _rivals(present: ExaminedModel, name: str, tried: set[str], part: float) -> list[RankedEffect]:
    """Return untried effects that look like one of that name, or gain a part of its gain, the best first.

    Effects with a scan are left out: the filter finds a time constant only from nearby, so a run is no fair
    test of them.
    """
    found = present.find(name)
    if found is None or found.profile is not None:
        return []
    others = [item for item in present.ranked if item.effect.name not in tried and item.profile is None]
    names = set(indistinguishable(found, others, present.scores, NONE, present.settings))
    close = [item for item in others if item.effect.name in names or item.fit.gain > part * found.fit.gain]
    return close[: present.settings.max_rivals]
