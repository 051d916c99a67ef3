"""From score statistics to a ranked list: the effect that explains most, and effects that look like it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit, fit, preference
from gyrocal_ros.diagnose.analysis.candidates import columns_of
from gyrocal_ros.diagnose.analysis.profile import Profile, profile
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.effects.traits import (
    follows_signal,
    is_disturbance,
    is_usual,
    scanned_coefficient,
    strengths,
    why_disturbed,
)
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.model.sensor import Effect, with_means

MUCH_MORE = 2.0
"""Gain relative to that of a significant effect from which one that explains less evenly is the likelier."""
MOST_COMBINATIONS = 50
"""Number of combinations of effects that are looked at, the ones that gain most."""
MAX_TOGETHER = 3
"""Number of effects that may explain a recording together."""


@dataclass(frozen=True, slots=True, eq=False)
class RankedEffect:
    """One candidate effect with its fit to the recording."""

    effect: Effect
    columns: IntArray
    """(k,) indices of its coefficients among all candidates'."""
    fit: Fit
    """Fit of the coefficients. With a scan, of the linear ones at the best value and its better neighbour
    together, for the true value is between."""
    merit: float
    """Log-likelihood gain less the price of the coefficients."""
    is_significant: bool
    """True if chance is no explanation."""
    could_show: bool
    """True if an effect as strong as its prior allows would be significant in this recording."""
    profile: Profile | None = None
    """Profile likelihood of the scanned coefficient, where the effect has one."""

    @property
    def places(self) -> IntArray:
        """(q,) indices of the fitted coefficients within the effect; a scanned one is not fitted."""
        return self.fit.columns - self.columns[0] if self.profile is None else strengths(self.effect)


def rank(scores: ScoreStatistics, settings: DiagnosisSettings) -> list[RankedEffect]:
    """Rank every candidate that the recording excites, the best first; the best variant of each name.

    The significant ones come before all others. Among them the gain decides, not the significance: the
    most certain effect need not explain most.
    """
    variants: dict[str, list[RankedEffect]] = {}
    for effect, columns in zip(scores.candidates, columns_of(scores.candidates), strict=True):
        fitted = fit(scores, columns)
        if fitted is not None and _is_complete(effect, fitted):
            variants.setdefault(effect.name, []).append(_ranked(effect, columns, fitted, settings))
    best = [_best_of(items, scores, settings) for items in variants.values()]
    return sorted(best, key=_order, reverse=True)


def without_disturbed(
    ranked: Sequence[RankedEffect], settings: DiagnosisSettings
) -> tuple[list[RankedEffect], dict[str, str]]:
    """Leave out what is no fault of a sensor, and the effects that cannot be judged because of it.

    A disturbance may explain unevenly: half of what makes an effect significant is enough for it, where it
    has a usual size and explains more than the effect.

    Args:
        ranked: ranked effects and disturbances.
        settings: thresholds.

    Returns:
        The effects that are judged, in the same order, and of each one that is not the reason, by name.
    """
    least = 0.5 * settings.significant_sigma
    likely = [item for item in ranked if is_disturbance(item.effect) and item.fit.sigma > least]
    shown = [item for item in likely if is_usual(item.effect, estimate(item))]
    judged, disturbed = [], {}
    for item in ranked:
        stronger = (other.effect for other in shown if other.merit > item.merit)
        why = next(filter(None, (why_disturbed(item.effect, other) for other in stronger)), '')
        if why:
            disturbed[item.effect.name] = why
        elif not is_disturbance(item.effect):
            judged.append(item)
    return judged, disturbed


def best_explanation(
    ranked: Sequence[RankedEffect],
    scores: ScoreStatistics,
    tried: Collection[str],
    settings: DiagnosisSettings,
) -> RankedEffect | None:
    """Return the effect that explains most; None where nothing is significant.

    Two effects at once may look like a third. So where two together explain significantly more than the
    best alone, the stronger of the two is returned. Two recorded signals must explain more than that in place
    of a law: that of a vibration is fitted to a noisy measure of it.

    Args:
        ranked: ranked effects, the best first.
        scores: the score statistics that they were ranked by.
        tried: names of effects to leave out.
        settings: thresholds.
    """
    untried = [item for item in ranked if item.effect.name not in tried]
    alone = [item for item in untried if item.is_significant]
    if not alone:
        return None
    best = single = _much_likelier(alone[0], untried, settings)
    most = single.merit
    for first in alone:
        for second in untried:
            both = _together((first, second), scores, settings) if second is not first else None
            if both is None or both.merit <= most:
                continue
            are_signals = follows_signal(first.effect) and follows_signal(second.effect)
            is_law = are_signals and not follows_signal(single.effect)
            part = settings.signals_part if is_law else settings.pair_part
            if both.merit > (1.0 + part) * single.merit + settings.significant_gain:
                best, most = both.effects[0], both.merit
    return best


def _much_likelier(
    best: RankedEffect, untried: Sequence[RankedEffect], settings: DiagnosisSettings
) -> RankedEffect:
    """Return the significant effect that explains most, or one that gains much more though less evenly.

    That something is missing is certain; what it is, so large a difference of the gains tells.
    """
    much = [
        item
        for item in untried
        if item.profile is None
        and item.fit.sigma > settings.uneven_sigma
        and item.merit > MUCH_MORE * best.merit
    ]
    return max(much, key=lambda item: item.merit, default=best)


def explained_together(
    ranked: Sequence[RankedEffect], scores: ScoreStatistics, settings: DiagnosisSettings
) -> float:
    """Return the log-likelihood that several effects gain together, each significant beside the others.

    Args:
        ranked: ranked effects, the best first.
        scores: the score statistics that they were ranked by.
        settings: thresholds.
    """
    left = [item for item in ranked if item.merit > 0.0]
    columns, gain = np.empty(0, np.int64), 0.0
    for _ in range(MAX_TOGETHER):
        fits = [(item, fit(scores, item.fit.columns, columns)) for item in left]
        significant = [
            (item, beside)
            for item, beside in fits
            if beside is not None and beside.sigma >= settings.significant_sigma
        ]
        if not significant:
            break
        best, beside = max(significant, key=lambda pair: pair[1].gain)
        columns, gain = np.concatenate([columns, best.fit.columns]), gain + beside.gain
        left.remove(best)
    return gain


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Several effects that explain a recording together, the strongest first."""

    effects: tuple[RankedEffect, ...]
    beside: tuple[Fit, ...]
    """Fit of each beside all others."""
    merit: float


def best_together(
    ranked: Sequence[RankedEffect],
    scores: ScoreStatistics,
    count: int,
    signals: int,
    settings: DiagnosisSettings,
) -> Together | None:
    """Return the effects that explain most together, whether or not one of them explains anything alone.

    Where all are missing, the estimates of each alone scatter; those of the right ones together do not.
    Effects with a scan are left out.

    Args:
        ranked: ranked effects.
        scores: the score statistics that they were ranked by.
        count: number of effects.
        signals: number of effects among them, at most, that follow a recorded signal.
        settings: thresholds.
    """
    linear = [item for item in ranked if item.profile is None]
    found = [
        (fitted.gain, items)
        for items in combinations(linear, count)
        if sum(follows_signal(item.effect) for item in items) <= signals
        and (fitted := fit(scores, _columns(items))) is not None
    ]
    found.sort(key=lambda pair: pair[0], reverse=True)
    significant = (_together(items, scores, settings) for _, items in found[:MOST_COMBINATIONS])
    return next((item for item in significant if item is not None), None)


def _columns(items: Iterable[RankedEffect]) -> IntArray:
    return np.concatenate([item.fit.columns for item in items])


def _together(
    items: Sequence[RankedEffect], scores: ScoreStatistics, settings: DiagnosisSettings
) -> Together | None:
    """Fit effects together; return None where one of them is not significant beside the others."""
    joint, fits = fit(scores, _columns(items)), []
    for item in items:
        beside = fit(scores, item.fit.columns, _columns(other for other in items if other is not item))
        if beside is None or beside.sigma < settings.significant_sigma:
            return None
        fits.append((item, beside))
    if joint is None:
        return None
    effects, sorted_fits = zip(*sorted(fits, key=lambda pair: pair[1].gain, reverse=True), strict=True)
    return Together(effects, sorted_fits, joint.gain - sum(item.fit.gain - item.merit for item in items))


def indistinguishable(
    found: RankedEffect,
    others: Iterable[RankedEffect],
    scores: ScoreStatistics,
    beside: IntArray,
    settings: DiagnosisSettings,
) -> list[str]:
    """Return the names of effects that explain the recording nearly as well in place of one that was found.

    Args:
        found: the effect that was found.
        others: effects that were not.
        scores: score statistics of all of them.
        beside: (q,) columns of the other effects that were found.
        settings: thresholds.
    """
    best = fit(scores, found.fit.columns, beside)
    if best is None:
        return []
    instead = {other.effect.name: fit(scores, other.fit.columns, beside) for other in others}
    return [
        name
        for name, other in instead.items()
        if other is not None
        and other.gain >= settings.indistinguishable_correlation**2 * best.gain
        and preference(best, other) < settings.indistinguishable_sigma
    ]


def with_estimate(ranked: RankedEffect, scores: ScoreStatistics, settings: DiagnosisSettings) -> Effect:
    """Return the effect with priors from the first half of the recording, so that the rest tests it.

    The filter has to start near: with a wide prior, some steps about a wrong value can lead it astray. How
    near follows from the difference of both halves. A scanned coefficient is estimated from the whole.
    """
    stds = np.array([item.prior_std for item in ranked.effect.coefficients], float)
    if ranked.profile is not None:
        found = ranked.profile
        stds[ranked.places] = np.maximum(np.abs(found.linear), found.linear_stds)
        stds[scanned_coefficient(ranked.effect)] = settings.scan_start_part * found.value
        return _with_priors(ranked.effect, estimate(ranked), stds)
    values = np.array([item.prior_mean for item in ranked.effect.coefficients], float)
    half, whole, places = fit(scores.first_half(), ranked.fit.columns), ranked.fit, ranked.places
    if half is not None and len(half.values) == len(whole.values):
        # The estimate of a half that does not show the effect is chance: the prior is the better start.
        start = half.values if half.sigma >= settings.nonzero_sigma else np.zeros(len(whole.values))
        values[places] += start
        at_least = [
            settings.start_sigma * np.sqrt(np.diagonal(half.covariance)),
            np.abs(start - whole.values),
            settings.start_part * np.abs(whole.values),
        ]
        stds[places] = np.minimum(stds[places], np.max(at_least, axis=0))
    return _with_priors(ranked.effect, values, stds)


def estimate(ranked: RankedEffect) -> Array:
    """Return the estimates of the coefficients (k,) by the score statistics of the whole recording."""
    values = np.array([item.prior_mean for item in ranked.effect.coefficients], float)
    if ranked.profile is None:
        values[ranked.places] += ranked.fit.values
        return values
    values[ranked.places] = ranked.profile.linear
    values[scanned_coefficient(ranked.effect)] = ranked.profile.value
    return values


def estimate_stds(ranked: RankedEffect) -> Array:
    """Return the standard deviations (k,) of the estimates; zero for a coefficient that was not fitted."""
    stds = np.zeros(len(ranked.effect.coefficients))
    if ranked.profile is None:
        stds[ranked.places] = np.sqrt(np.diagonal(ranked.fit.covariance))
        return stds
    stds[ranked.places] = ranked.profile.linear_stds
    stds[scanned_coefficient(ranked.effect)] = ranked.profile.std
    return stds


def _is_complete(effect: Effect, fitted: Fit) -> bool:
    """Return True if the variants of an effect with a scan can be compared: all linear coefficients show."""
    return scanned_coefficient(effect) is None or len(fitted.values) == len(strengths(effect))


def _ranked(
    effect: Effect,
    columns: IntArray,
    fitted: Fit,
    settings: DiagnosisSettings,
    scanned: Profile | None = None,
) -> RankedEffect:
    """Compute merit and significance of a fitted effect."""
    merit = fitted.gain - settings.coefficient_price * len(fitted.values)
    is_significant = fitted.sigma >= settings.significant_sigma and merit > 0.0
    item = RankedEffect(effect, columns, fitted, merit, is_significant, could_show=False, profile=scanned)
    usual = np.array([coefficient.prior_std for coefficient in effect.coefficients])
    would_show = (usual > settings.significant_sigma * estimate_stds(item))[item.places]
    return replace(item, could_show=bool(np.any(would_show)))


def _best_of(
    variants: list[RankedEffect], scores: ScoreStatistics, settings: DiagnosisSettings
) -> RankedEffect:
    """Return the best variant of an effect, with the profile likelihood over its scan."""
    best = max(variants, key=_order)
    place = scanned_coefficient(best.effect)
    if len(variants) == 1 or place is None:
        return best
    nothing = np.zeros(len(best.effect.coefficients)).tolist()
    form = with_means(best.effect, nothing)
    series = [item for item in variants if with_means(item.effect, nothing) == form]
    row = series.index(best)
    neighbours = series[max(row - 1, 0) : row] + series[row + 1 : row + 2]
    if not neighbours:  # the other values of the scan are not excited
        return best
    neighbour = max(neighbours, key=_order)
    between = fit(scores, np.concatenate([best.fit.columns, neighbour.fit.columns]))
    scanned = [item.effect.coefficients[place].prior_mean for item in series]
    along = profile(scanned, [item.fit for item in series])
    return _ranked(best.effect, best.columns, between or best.fit, settings, along)


def _with_priors(effect: Effect, values: Array, stds: Array) -> Effect:
    items = zip(with_means(effect, values.tolist()).coefficients, stds.tolist(), strict=True)
    coefficients = tuple(replace(item, prior_std=std) for item, std in items)
    return replace(effect, coefficients=coefficients)  # type: ignore[type-var]


def _order(ranked: RankedEffect) -> tuple[bool, float]:
    return ranked.is_significant, ranked.merit if np.isfinite(ranked.merit) else -np.inf
