"""Candidate effects, models and drifts of a search, as rows and curves for figures."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import BlindDrift, blind_drift, held_out_from_s, reference_heading
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.effects.traits import has_impossible_sign

MAX_CANDIDATES = 18
"""Number of candidates up to which the significant ones are complemented by others."""
FIRST_MODEL = 'the first model'
"""Name of the model that a search begins with."""


@dataclass(frozen=True, slots=True)
class CandidateRow:
    """One candidate effect, and its significance once the effects found are in the model."""

    name: str
    role: str
    """`best`, `found`, `twin`, `significant` or `chance`."""
    gain: float
    """Log-likelihood gain."""
    sigma: float
    sigma_left: float
    """Significance in the final model; NaN where the effect is part of that."""


def candidate_rows(searched: Search, diagnosis: Diagnosis) -> list[CandidateRow]:
    """Return all significant effects and some others, the one that explains most first."""
    found = {item.effect.name for item in diagnosis.missing}
    twins = {name for item in diagnosis.missing for name in item.confused_with}
    left = {ranked.effect.name: ranked.fit.sigma for ranked in searched.last.ranked}
    rows = [
        CandidateRow(
            name=ranked.effect.name,
            role=_role(ranked.effect.name, ranked.is_significant, found, twins),
            gain=ranked.fit.gain,
            sigma=ranked.fit.sigma,
            sigma_left=left.get(ranked.effect.name, math.nan),
        )
        for ranked in diagnosis.ranked
    ]
    listed = {row.name for row in rows}
    rows += [
        CandidateRow(item.effect.name, 'found', item.gain, item.sigma, math.nan)
        for item in diagnosis.missing
        if item.effect.name not in listed and math.isfinite(item.gain)
    ]
    return _strongest(rows, MAX_CANDIDATES)


def open_candidate_rows(
    examined: ExaminedModel, best: str | None, twins: Collection[str], most: int
) -> list[CandidateRow]:
    """Return all significant effects that a model may lack, and others up to `most`.

    Args:
        examined: the model on the recording.
        best: the effect that explains most, if there is one.
        twins: effects that cannot be distinguished from it.
        most: number of rows up to which the significant ones are complemented by others.
    """
    rows = []
    for ranked in examined.ranked:
        name, fit = ranked.effect.name, ranked.fit
        role = 'best' if name == best else _role(name, ranked.is_significant, (), twins)
        rows.append(CandidateRow(name, role, fit.gain, fit.sigma, math.nan))
    return _strongest(rows, most)


def _strongest(rows: list[CandidateRow], most: int) -> list[CandidateRow]:
    rows.sort(key=lambda row: row.gain, reverse=True)
    room = max(most - sum(row.role != 'chance' for row in rows), 0)
    chance = [row for row in rows if row.role == 'chance'][:room]
    return [row for row in rows if row.role != 'chance' or row in chance]


def _role(name: str, is_significant: bool, found: Collection[str], twins: Collection[str]) -> str:
    if name in found:
        return 'found'
    if name in twins:
        return 'twin'
    return 'significant' if is_significant else 'chance'


def models_that_ran(searched: Search) -> dict[str, ExaminedModel]:
    """Return the models of a search by name: the first, with each effect kept, without each one removed.

    The first model is missing where the filter diverged with it.
    """
    named = {FIRST_MODEL: searched.first}
    named |= {f'with {item.effect.name}': item.after for item in searched.kept}
    named |= {f'without {item.effect.name}': item.after for item in searched.removals}
    diverged = any(item.before is None for item in searched.additions)
    return {name: examined for name, examined in named.items() if name != FIRST_MODEL or not diverged}


def held_out_drifts(searched: Search) -> dict[str, BlindDrift]:
    """Compute the drift on held-out spans by name of the model."""
    reference = reference_heading(searched.last.run)
    return {
        name: blind_drift(examined.run, reference, held_out_from_s(examined.run))
        for name, examined in models_that_ran(searched).items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class EffectCurve:
    """The contribution of an effect, with its standard deviation."""

    x_label: str
    y_label: str
    x: Array
    """(n,)"""
    y: Array
    std: Array


def effect_curve(found: MissingEffect) -> EffectCurve | None:
    """Compute the contribution of an effect that was found against the quantity that excites it.

    The coefficients count as independent.

    Returns:
        None for an effect that follows a recorded signal, for `error_curves` has its curve, and for one with
        a sign that no sensor has: a negative lag runs away.
    """
    effect = find_effect(found.effect.name)
    if effect.about.shown_against == 'signal' or has_impossible_sign(effect, found.values, found.stds):
        return None

    def curve(values: Array) -> Array:
        return list(sketch(effect, [tuple(values.tolist())]).lines.values())[-1]

    drawn, y = sketch(effect, [tuple(found.values.tolist())]), curve(found.values)
    moved = [curve(found.values + step) - y for step in np.diag(found.stds)]
    return EffectCurve(drawn.x_label, drawn.y_label, drawn.x, y, np.sqrt(np.sum(np.square(moved), axis=0)))
