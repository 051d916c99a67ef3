"""From evidence to a ranked list: which effect explains most, and what could be mistaken for it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.candidate_fit import SIGNIFICANT_SIGMA, Fit, fit, preference
from gyrocal_ros.diagnose.candidates import columns_of, with_means
from gyrocal_ros.diagnose.profile import Profile, profile
from gyrocal_ros.ekf.score_statistics import ScoreStatistics
from gyrocal_ros.model.sensor import Effect

PRICE = 4.0
"""Log-likelihood that a coefficient has to gain to be worth it: half the logarithm of the number of images
in some minutes (Schwarz 1978)."""
TWIN_SIGMA = 3.0
"""A candidate that explains the recording so nearly as well may be meant instead."""
TWIN_CORRELATION = 0.87
"""From here on two effects look alike: of what is due to one, the other explains this part, squared."""
PAIR_PART = 0.02
"""Two have to explain so much more than one alone: what is strong is not told exactly."""
AT_LEAST_SIGMA, AT_LEAST_PART = 3.0, 0.2
"""A coefficient may still move by so many of its standard deviations, and by this part of it."""
NEARBY = 0.4
"""Part of a time constant by which the filter may still move it: further out it goes astray."""


@dataclass(frozen=True, slots=True, eq=False)
class RankedEffect:
    """One candidate effect as the recording sees it."""

    effect: Effect
    columns: IntArray
    fit: Fit
    """Of an effect with a time constant: at the best one tried together with its neighbour, for the
    true one lies between."""
    profile: Profile | None = None
    """Of the time constant, where the effect has one."""

    @property
    def places(self) -> IntArray:
        """(q,) which coefficients of the effect were fitted; a time constant is not at first."""
        return self.fit.columns - self.columns[0] if self.profile is None else np.zeros(1, np.int64)

    @property
    def merit(self) -> float:
        """Log-likelihood gain less the price of the coefficients, a time constant too."""
        return self.fit.gain - PRICE * len(self.fit.values)

    @property
    def is_significant(self) -> bool:
        """Whether chance is no explanation."""
        return self.fit.sigma >= SIGNIFICANT_SIGMA and self.merit > 0.0

    @property
    def could_show(self) -> bool:
        """Whether an effect as strong as its prior allows would be significant here."""
        usual = np.array([item.prior_std for item in self.effect.coefficients])
        stds = doubts(self)
        return bool(np.any((usual > SIGNIFICANT_SIGMA * stds)[self.places]))


def rank(scores: ScoreStatistics) -> list[RankedEffect]:
    """Every candidate that the recording excites, the best first; the best variant of each name.

    The significant ones come before all others; among them counts how much they explain, for what
    is most certain need not explain most.
    """
    variants: dict[str, list[RankedEffect]] = {}
    for effect, columns in zip(scores.candidates, columns_of(scores.candidates), strict=True):
        fitted = fit(scores, columns)
        if fitted is not None:
            variants.setdefault(effect.name, []).append(RankedEffect(effect, columns, fitted))
    best = [_best_of(items, scores) for items in variants.values()]
    return sorted(best, key=_order, reverse=True)


def best_explanation(
    ranked: Sequence[RankedEffect], scores: ScoreStatistics, tried: Collection[str]
) -> RankedEffect | None:
    """The effect that explains most; None where nothing is significant.

    Two effects at once may look like a third. So where two together explain more than chance beyond
    what the best alone does, it is the stronger one of them.

    Args:
        suspects: the best first.
        evidence: what they were ranked by.
        tried: names that are out of the question.
    """
    open_to_choice = [ranked_effect for ranked_effect in ranked if ranked_effect.effect.name not in tried]
    alone = [ranked_effect for ranked_effect in open_to_choice if ranked_effect.is_significant]
    if not alone:
        return None
    best = alone[0]
    most = (1.0 + PAIR_PART) * best.merit + 0.5 * SIGNIFICANT_SIGMA**2
    for first in alone:
        for second in open_to_choice:
            both = _beside(first, second, scores) if second is not first else None
            if both is not None and both.merit > most:
                best, most = both.stronger, both.merit
    return best


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Two effects that explain a recording together."""

    stronger: RankedEffect
    merit: float


def _beside(first: RankedEffect, second: RankedEffect, scores: ScoreStatistics) -> _Pair | None:
    """Both together; None where one of them is chance beside the other."""
    a, b = first.fit.columns, second.fit.columns
    joint, more, less = fit(scores, np.concatenate([a, b])), fit(scores, a, b), fit(scores, b, a)
    if joint is None or more is None or less is None or min(more.sigma, less.sigma) < SIGNIFICANT_SIGMA:
        return None
    price = first.fit.gain - first.merit + second.fit.gain - second.merit
    return _Pair(first if more.gain >= less.gain else second, joint.gain - price)


def twins(
    ranked_effect: RankedEffect, others: Iterable[RankedEffect], scores: ScoreStatistics, beside: IntArray
) -> list[str]:
    """Names of the effects that could stand in place of one, and would explain nearly as much.

    Args:
        suspect: the one that was found.
        others: those that were not.
        evidence: of all of them.
        beside: (q,) columns of the effects that were found as well.
    """
    found = fit(scores, ranked_effect.fit.columns, beside)
    if found is None:
        return []
    instead = {other.effect.name: fit(scores, other.fit.columns, beside) for other in others}
    return [
        name
        for name, other in instead.items()
        if other is not None
        and other.gain >= TWIN_CORRELATION**2 * found.gain
        and preference(found, other) < TWIN_SIGMA
    ]


def with_estimate(ranked_effect: RankedEffect, scores: ScoreStatistics) -> Effect:
    """The effect, expected where the first half of the recording puts it, so that the rest tests it.

    The filter has to begin near: where an effect is doubtful by its usual size, some steps about the wrong
    place can lead it astray. How near is told by both halves. A time constant is told by the whole.
    """
    if ranked_effect.profile is not None:
        told = ranked_effect.profile
        near = (max(abs(told.amplitude), told.amplitude_std), NEARBY * told.value)
        return _expected(ranked_effect.effect, estimate(ranked_effect), np.array(near))
    values = np.array([item.prior_mean for item in ranked_effect.effect.coefficients])
    stds = np.array([item.prior_std for item in ranked_effect.effect.coefficients])
    half, whole, places = (
        fit(scores.first_half(), ranked_effect.fit.columns),
        ranked_effect.fit,
        ranked_effect.places,
    )
    if half is not None and len(half.values) == len(whole.values):
        values[places] += half.values
        at_least = [
            AT_LEAST_SIGMA * np.sqrt(np.diagonal(half.covariance)),
            np.abs(half.values - whole.values),
            AT_LEAST_PART * np.abs(whole.values),
        ]
        stds[places] = np.minimum(stds[places], np.max(at_least, axis=0))
    return _expected(ranked_effect.effect, values, stds)


def _expected(effect: Effect, values: Array, stds: Array) -> Effect:
    items = zip(with_means(effect, values.tolist()).coefficients, stds.tolist(), strict=True)
    coefficients = tuple(replace(item, prior_std=std) for item, std in items)
    return replace(effect, coefficients=coefficients)  # type: ignore[type-var]


def estimate(ranked_effect: RankedEffect) -> Array:
    """Coefficients (k,) by the evidence of the whole recording."""
    if ranked_effect.profile is not None:
        return np.array([ranked_effect.profile.amplitude, ranked_effect.profile.value])
    values = np.array([item.prior_mean for item in ranked_effect.effect.coefficients])
    values[ranked_effect.places] += ranked_effect.fit.values
    return values


def doubts(ranked_effect: RankedEffect) -> Array:
    """Standard deviations (k,) of the coefficients by the evidence; zero for one that was not fitted."""
    if ranked_effect.profile is not None:
        return np.array([ranked_effect.profile.amplitude_std, ranked_effect.profile.std])
    stds = np.zeros(len(ranked_effect.effect.coefficients))
    stds[ranked_effect.places] = np.sqrt(np.diagonal(ranked_effect.fit.covariance))
    return stds


def _best_of(variants: list[RankedEffect], scores: ScoreStatistics) -> RankedEffect:
    """The best variant of an effect; of one with a time constant, with what the others say of that."""
    best = max(variants, key=_order)
    if len(variants) == 1:
        return best
    form = with_means(best.effect, (0.0, 0.0))
    series = [item for item in variants if with_means(item.effect, (0.0, 0.0)) == form]
    place = series.index(best)
    neighbour = max(series[max(place - 1, 0) : place] + series[place + 1 : place + 2], key=_order)
    between = fit(scores, np.concatenate([best.fit.columns, neighbour.fit.columns]))
    times_s = [item.effect.coefficients[1].prior_mean for item in series]
    return replace(best, fit=between or best.fit, profile=profile(times_s, [item.fit for item in series]))


def _order(ranked_effect: RankedEffect) -> tuple[bool, float]:
    return ranked_effect.is_significant, ranked_effect.merit if np.isfinite(ranked_effect.merit) else -np.inf
