"""From evidence to a ranked list: which effect explains most, and what could be mistaken for it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.diagnose.candidates import columns_of
from gyrocal_ros.diagnose.evidence import Fit, correlation, fit, preference
from gyrocal_ros.ekf.evidence import Evidence
from gyrocal_ros.model.sensor import Effect

SIGNIFICANT_SIGMA = 4.5
"""Below this a candidate counts as chance: many are tried at once."""
TWIN_SIGMA = 3.0
"""A candidate that explains the recording so nearly as well may be meant instead."""
TWIN_CORRELATION = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """One candidate effect as the recording sees it."""

    effect: Effect
    columns: IntArray
    fit: Fit

    @property
    def merit(self) -> float:
        """Log-likelihood gain less a price of one for each coefficient (Akaike 1974)."""
        return self.fit.gain - len(self.fit.values)

    @property
    def is_significant(self) -> bool:
        """Whether chance is no explanation."""
        return self.fit.sigma >= SIGNIFICANT_SIGMA and self.merit > 0.0


def rank(evidence: Evidence) -> list[Suspect]:
    """Every candidate that the recording excites, the best first; the best variant of each name.

    The significant ones come before all others; among them counts how much they explain, for what
    is most certain need not explain most.
    """
    best: dict[str, Suspect] = {}
    for effect, columns in zip(evidence.candidates, columns_of(evidence.candidates), strict=True):
        fitted = fit(evidence, columns)
        if fitted is None:
            continue
        suspect = Suspect(effect, columns, fitted)
        rival = best.get(effect.name)
        if rival is None or _order(suspect) > _order(rival):
            best[effect.name] = suspect
    return sorted(best.values(), key=_order, reverse=True)


def twins(suspect: Suspect, others: Iterable[Suspect], evidence: Evidence) -> list[str]:
    """Names of the candidates that explain this recording nearly as well, for they look alike."""
    return [
        other.effect.name
        for other in others
        if other.effect.name != suspect.effect.name
        and other.is_significant
        and preference(suspect.fit, other.fit) < TWIN_SIGMA
        and correlation(evidence, suspect.columns, other.columns) > TWIN_CORRELATION
    ]


def with_estimate(suspect: Suspect) -> Effect:
    """The effect, its prior means moved to what the evidence says; the prior doubts stay."""
    items = list(suspect.effect.coefficients)
    first = int(suspect.columns[0])
    for column, value in zip(suspect.fit.columns, suspect.fit.values, strict=True):
        place = int(column) - first
        items[place] = replace(items[place], prior_mean=items[place].prior_mean + float(value))
    return replace(suspect.effect, coefficients=tuple(items))  # type: ignore[type-var]


def unexcited(evidence: Evidence, ranked: Sequence[Suspect]) -> list[str]:
    """Names of the candidates that this recording cannot judge at all."""
    judged = {suspect.effect.name for suspect in ranked}
    return sorted({effect.name for effect in evidence.candidates} - judged)


def _order(suspect: Suspect) -> tuple[bool, float]:
    return suspect.is_significant, suspect.merit if np.isfinite(suspect.merit) else -np.inf
