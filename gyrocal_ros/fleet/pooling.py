"""Effects that a whole fleet lacks: score statistics of many bags, pooled with bags as clusters.

The statistics Lambda and b of a bag add up over bags with the same coefficients, so an effect far below the
noise of one bag shows in many. Its significance is judged by the scatter from bag to bag, which also holds
where the coefficient differs between robots (`diagnose.analysis.candidate_fit`, with bags in place of
blocks). Effects that one bag cannot tell apart can be distinguished where the bags differ in their
conditions: the sum of their Lambda is better conditioned than each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit, correlation, fit, preference
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.fleet.table import ScoreTable

SIGNIFICANT_SIGMA = 5.0
"""Significance from which an effect of the fleet is not chance."""
MIN_PER_BAG_SIGMA = 0.5
"""Least size of an effect of the fleet, in standard deviations of one bag: the linearised filter itself
leaves some 0.2, which adds up over bags like an effect."""
MIN_BAGS = 8
"""Minimum number of bags from which the scatter between them is known."""
CONTENDERS = 16
"""Number of candidates that are fitted together; the others are less significant alone."""
MAX_FOUND = 3
"""Number of effects that are looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class PooledEffect:
    """An effect that the fleet lacks, by the pooled score statistics."""

    effect: str
    candidate: str
    """The effect, with the value of its scan where it has one."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    """(q,) mean over the bags, weighted by their information."""
    stds: Array
    sigma: float
    gain: float
    """Log-likelihood gained over all bags."""
    per_bag_sigma: float
    """Size in standard deviations of a single bag of median information."""
    columns: IntArray
    """(q,) columns of the score table."""
    confused_with: tuple[str, ...]
    """Effects that all bags together cannot distinguish from it."""
    separated_from: tuple[str, ...]
    """Effects that a typical bag alone cannot distinguish from it, and all together can."""


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
    """Conclusion from the pooled score statistics."""

    found: tuple[PooledEffect, ...]
    strongest: PooledEffect | None
    """The most significant candidate, where none is significant."""
    bags: int


def candidate_of(name: str) -> str:
    """Return the candidate of a column: its name without the coefficient, with the value of its scan."""
    stem, scan, value = name.partition('@')
    return f'{stem.rsplit(".", 1)[0]}{scan}{value}'


def effect_of(candidate: str) -> str:
    """Return the effect of a candidate."""
    return candidate.partition('@')[0].partition('[')[0]


def pool(
    scores: ScoreTable,
    information: Callable[[IntArray], Array],
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> Pooled:
    """Find the effects that all bags together show.

    Args:
        scores: score statistics of the bags.
        information: returns Lambda (n, q, q) of some columns (q,).
        settings: price of a coefficient, and when two effects cannot be distinguished.
    """
    if len(scores.bags) < MIN_BAGS:
        return Pooled((), None, len(scores.bags))
    groups = _contenders(scores)
    columns = np.concatenate([*groups.values()]) if groups else np.empty(0, np.int64)
    blocks = ScoreStatistics(
        (), np.arange(float(len(scores.bags))), information(columns), scores.score[:, columns]
    )
    places = {name: np.searchsorted(columns, group) for name, group in groups.items()}
    found: list[PooledEffect] = []
    given = np.empty(0, np.int64)
    strongest: PooledEffect | None = None
    while len(found) < MAX_FOUND:
        taken = {item.effect for item in found}
        fits = {
            name: fitted
            for name, group in places.items()
            if effect_of(name) not in taken and (fitted := fit(blocks, group, given)) is not None
        }
        if not fits:
            break
        best = max(fits, key=lambda name: _merit(fits[name], settings))
        item = _described(best, fits, blocks, places, given, scores, columns, settings)
        strongest = strongest or item
        if item.sigma < SIGNIFICANT_SIGMA or item.per_bag_sigma < MIN_PER_BAG_SIGMA:
            break
        found.append(item)
        given = np.concatenate([given, places[best]])
    return Pooled(tuple(found), None if found else strongest, len(scores.bags))


def _contenders(scores: ScoreTable) -> dict[str, IntArray]:
    """Return the columns of the most significant candidates, in the order of the columns."""
    total = scores.information.sum(axis=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        z = np.abs(scores.score.sum(axis=0)) / np.sqrt(total)
    groups: dict[str, list[int]] = {}
    for column, name in enumerate(scores.names):
        groups.setdefault(candidate_of(name), []).append(column)
    ranked = sorted(groups, key=lambda name: -max(np.nan_to_num(z[groups[name]])))[:CONTENDERS]
    return {name: np.array(groups[name], np.int64) for name in groups if name in ranked}


def _merit(fitted: Fit, settings: DiagnosisSettings) -> float:
    return fitted.gain - settings.coefficient_price * len(fitted.values)


def _described(
    best: str,
    fits: dict[str, Fit],
    blocks: ScoreStatistics,
    places: dict[str, IntArray],
    given: IntArray,
    scores: ScoreTable,
    columns: IntArray,
    settings: DiagnosisSettings,
) -> PooledEffect:
    """Return the best candidate with the effects that look like it."""
    fitted = fits[best]
    rivals = {name: other for name, other in fits.items() if effect_of(name) != effect_of(best)}
    confused = [
        effect_of(name)
        for name, other in rivals.items()
        if other.gain >= settings.indistinguishable_correlation**2 * fitted.gain
        and preference(fitted, other) < settings.indistinguishable_sigma
    ]
    alike_in_one_bag = [
        effect_of(name)
        for name in rivals
        if _typical_correlation(blocks, places[best], places[name]) > settings.indistinguishable_correlation
    ]
    own = columns[fitted.columns]
    return PooledEffect(
        effect=effect_of(best),
        candidate=best,
        names=tuple(scores.names[column] for column in own),
        units=tuple(scores.units[column] for column in own),
        values=fitted.values,
        stds=np.sqrt(np.diagonal(fitted.covariance)),
        sigma=fitted.sigma,
        gain=fitted.gain,
        per_bag_sigma=_per_bag_sigma(fitted, blocks),
        columns=own,
        confused_with=tuple(dict.fromkeys(confused)),
        separated_from=tuple(name for name in dict.fromkeys(alike_in_one_bag) if name not in confused),
    )


def _per_bag_sigma(fitted: Fit, blocks: ScoreStatistics) -> float:
    """Return the size of an estimate in standard deviations of one bag of median information."""
    own = blocks.information[:, fitted.columns[:, None], fitted.columns]
    squares = np.einsum('i,bij,j->b', fitted.values, own, fitted.values)
    return math.sqrt(max(float(np.median(squares)), 0.0))


def _typical_correlation(blocks: ScoreStatistics, first: IntArray, second: IntArray, most: int = 50) -> float:
    """Return the median, over some bags, of the correlation of two candidates in one bag."""
    step = max(len(blocks.start_s) // most, 1)
    values = []
    for row in range(0, len(blocks.start_s), step):
        one = ScoreStatistics((), blocks.start_s[:1], blocks.information[row : row + 1], blocks.score[:1])
        values.append(_or_zero(one, first, second))
    return float(np.median(values))


def _or_zero(one: ScoreStatistics, first: IntArray, second: IntArray) -> float:
    try:
        return correlation(one, first, second)
    except np.linalg.LinAlgError:
        return 0.0


def expected_std(scores: ScoreTable, columns: Sequence[int]) -> Array:
    """Return the standard deviation (n, q) of the estimates in each bag for some columns.

    That of the filter, Lambda^-1/2, times the median over the bags of what the scatter within them adds;
    a factor for each bag would follow its own errors.
    """
    information = scores.information[:, columns]
    with np.errstate(invalid='ignore', divide='ignore'):
        filtered = np.where(information > 0.0, information, math.nan) ** -0.5
        factor = np.nanmedian(scores.std[:, columns] / filtered, axis=0)
    scaled: Array = filtered * np.maximum(np.nan_to_num(factor, nan=1.0), 1.0)
    return scaled
