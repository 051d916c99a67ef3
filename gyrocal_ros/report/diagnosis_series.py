"""What a diagnosis shows that does not stand in it as it is, as plain arrays."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.drift import BlindDrift, blind_drift, held_out_from_s, reference_path
from gyrocal_ros.diagnose.heading_filter import TURNING_RAD_S, Headings
from gyrocal_ros.diagnose.search import ExaminedModel, Search
from gyrocal_ros.diagnose.shapes import RATE, Shape, axes, hats, shapes
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.sketch import sketch
from gyrocal_ros.ekf.run import Run

MOMENTS = 400
"""A wandering heading is looked at in no more moments than this."""
WINDOW_S = 10.0
MOST_CANDIDATES = 18
"""Beside the significant ones, a chart shows no more candidates than fill it up to this."""
MOST_SHAPES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Wander:
    """Heading by the gyro less heading by the camera at m moments, the best constant bias taken out."""

    time_s: Array
    error_rad: Array
    std_rad: Array
    """(m,) what the noise of gyro and camera, and a bias that wanders, let expect."""
    gained_s: Array
    """(w,) middles of windows."""
    gained_rad: Array
    gained_std_rad: Array
    """(w,) what the heading error gained in each window, and what noise lets expect."""


@dataclass(frozen=True, slots=True)
class CandidateRow:
    """One effect that was on trial, and how it looks once the found ones are in the model."""

    name: str
    role: str
    """`best`, `found`, `twin`, `significant` or `chance`."""
    gain: float
    sigma: float
    sigma_left: float
    """In the final model; NaN where it is part of that."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """The error of the rate as a function of a signal, less its mean."""

    knots: Array
    values: Array
    """(k,) rad/s for the bias, 1 for the scale."""
    stds: Array


@dataclass(frozen=True, slots=True, eq=False)
class Bend:
    """One question asked of what is left over, before and after effects were added."""

    signal: str
    of_scale: bool
    before: Curve
    after: Curve | None
    """None where nothing was added."""
    predicted: Curve | None = None
    """What the effects that were added say of it; it should go through `before`."""


def wander(seen: Headings) -> Wander:
    """How the gyro's heading runs away from the camera's, and how far noise alone would take it.

    The noise is a random walk of the heading, one of the bias, and that of the camera; the bias that
    fits best is taken out of the error, and out of what noise lets expect likewise.
    """
    told = np.flatnonzero(np.isfinite(seen.seen_rad) & np.isfinite(seen.std_rad))
    chosen = np.unique(np.linspace(0, len(told) - 1, MOMENTS).astype(int))
    rows = told[chosen]
    away = np.cumsum(seen.turn_rad)[told] - seen.seen_rad[told]
    time_s, error = seen.time_s[rows], _without_strays(away)[chosen]
    covariance = _wander_covariance(seen, rows)
    basis = np.stack([np.ones(len(rows)), np.cumsum(seen.gyro_valid_s)[rows]], axis=1)
    without = np.eye(len(rows)) - basis @ np.linalg.pinv(basis)
    left, spread = without @ error, without @ covariance @ without.T
    edges = np.arange(time_s[0], time_s[-1], WINDOW_S)
    ends = np.unique(np.searchsorted(time_s, edges))
    jump = np.zeros((max(len(ends) - 1, 0), len(rows)))
    jump[np.arange(len(jump)), ends[1:]], jump[np.arange(len(jump)), ends[:-1]] = 1.0, -1.0
    return Wander(
        time_s=time_s,
        error_rad=left,
        std_rad=np.sqrt(np.diagonal(spread)),
        gained_s=0.5 * (time_s[ends[1:]] + time_s[ends[:-1]]),
        gained_rad=jump @ left,
        gained_std_rad=np.sqrt(np.einsum('wm,mn,wn->w', jump, spread, jump)),
    )


def _without_strays(values: Array) -> Array:
    """Each value (n,), or the one of its neighbours that lies between: one image alone may err by far."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    middle: Array = np.median([padded[:-2], values, padded[2:]], axis=0)
    return middle


def _wander_covariance(seen: Headings, rows: IntArray) -> Array:
    """(m, m) of the heading error by noise alone."""
    walk = seen.rate_noise_rad_s**2 + seen.map_walk_rad**2
    variance = np.cumsum(walk * seen.dt_s + seen.unobserved_turn_std_rad**2)[rows]
    time_s = seen.time_s[rows]
    first, last = np.minimum(time_s[:, None], time_s), np.maximum(time_s[:, None], time_s)
    by_bias = seen.bias_walk_rad_s**2 * first**2 * (3.0 * last - first) / 6.0
    return np.minimum(variance[:, None], variance) + by_bias + np.diag(seen.std_rad[rows] ** 2)


def candidates(searched: Search, diagnosis: Diagnosis) -> list[CandidateRow]:
    """All significant effects and the next ones, the one that explains most first."""
    found = {finding.effect.name for finding in diagnosis.missing}
    twins = {name for finding in diagnosis.missing for name in finding.confused_with}
    left = {ranked_effect.effect.name: ranked_effect.fit.sigma for ranked_effect in searched.last.ranked}
    table = [
        CandidateRow(
            name=ranked_effect.effect.name,
            role=_role(ranked_effect.effect.name, ranked_effect.is_significant, found, twins),
            gain=ranked_effect.fit.gain,
            sigma=ranked_effect.fit.sigma,
            sigma_left=left.get(ranked_effect.effect.name, math.nan),
        )
        for ranked_effect in diagnosis.ranked
    ]
    tried = {row.name for row in table}
    table += [
        CandidateRow(finding.effect.name, 'found', finding.gain, finding.sigma, math.nan)
        for finding in diagnosis.missing
        if finding.effect.name not in tried and math.isfinite(finding.gain)
    ]
    return _most_telling(table, MOST_CANDIDATES)


def open_candidates(
    stage: ExaminedModel, best: str | None, twins: Collection[str], most: int
) -> list[CandidateRow]:
    """All effects that a model may lack and that are significant, and the next ones up to `most`.

    Args:
        stage: the model on the recording.
        best: the effect that explains most, where there is one.
        twins: effects that may be meant in its place.
        most: beside the significant ones, no more than fill the list up to this.
    """
    table = []
    for ranked_effect in stage.ranked:
        name, fit = ranked_effect.effect.name, ranked_effect.fit
        role = 'best' if name == best else _role(name, ranked_effect.is_significant, (), twins)
        table.append(CandidateRow(name, role, fit.gain, fit.sigma, math.nan))
    return _most_telling(table, most)


def _most_telling(table: list[CandidateRow], most: int) -> list[CandidateRow]:
    table.sort(key=lambda row: row.gain, reverse=True)
    room = max(most - sum(row.role != 'chance' for row in table), 0)
    chance = [row for row in table if row.role == 'chance'][:room]
    return [row for row in table if row.role != 'chance' or row in chance]


def _role(name: str, is_significant: bool, found: Collection[str], twins: Collection[str]) -> str:
    if name in found:
        return 'found'
    if name in twins:
        return 'twin'
    return 'significant' if is_significant else 'chance'


def bends(searched: Search) -> list[Bend]:
    """What was left over as a function of what was recorded, the most telling first."""
    first, last = searched.first, searched.last
    before = {_question(shape): shape for shape in reversed(shapes(first.run, first.seen))}
    after = {} if last is first else {_question(shape): shape for shape in shapes(last.run, last.seen)}
    return [
        Bend(
            signal=shape.signal,
            of_scale=shape.of_scale,
            before=centred(shape),
            after=centred(after[question]) if question in after else None,
        )
        for question, shape in reversed(before.items())
    ][:MOST_SHAPES]


def centred(shape: Shape) -> Curve:
    """A shape less its mean over the knots, so that the first knot, from which it is told, has a doubt too.

    By the rate it is told less a straight line, which is no more than another scale factor.
    """
    free = np.flatnonzero(np.isfinite(shape.values) & (shape.stds > 0.0))
    covariance = np.zeros((len(shape.knots), len(shape.knots)))
    covariance[np.ix_(free, free)] = shape.fit.covariance
    known = np.flatnonzero(np.isfinite(shape.values))
    knots = shape.knots[known]
    bent = _bent(knots, shape.signal)
    spread = bent @ covariance[np.ix_(known, known)] @ bent.T
    return Curve(knots, bent @ shape.values[known], np.sqrt(np.maximum(np.diagonal(spread), 0.0)))


def predicted(run: Run, added: int, signal: str, asked: Curve, of_scale: bool) -> Curve | None:
    """What the effects that were added last say of the error of the rate, as a function of a signal.

    Args:
        run: with them.
        added: how many effects were added.
        signal: name of the signal.
        asked: at which knots to tell it.
        of_scale: as an error of the scale, else of the bias.

    Returns:
        None where they add nothing to the rate: effects of the camera or the wheels.
    """
    history = run.history
    count = sum(len(effect.coefficients) for effect in run.model.effects[len(run.model.effects) - added :])
    first = run.state.coefficient_count - count
    added_rad = history.columns[:, first:] @ run.state.coefficients[first:]
    values = dict(axes(run)).get(signal)
    if values is None or not np.any(added_rad):
        return None
    rate = history.turn_rad / history.dt_s
    parts = hats(np.where(np.isfinite(values), values, asked.knots[0]), asked.knots, signal)
    columns = parts * np.where(np.abs(rate) > TURNING_RAD_S, rate, 0.0)[:, None] if of_scale else parts
    basis = np.concatenate([columns, rate[:, None]], axis=1) * np.sqrt(history.dt_s)[:, None]
    told = np.linalg.lstsq(basis, added_rad / np.sqrt(history.dt_s))[0][: len(asked.knots)]
    return Curve(asked.knots, _bent(asked.knots, signal) @ told, np.zeros(len(told)))


def _bent(knots: Array, signal: str) -> Array:
    """(k, k): takes the mean over the knots away; by the rate, a straight line."""
    basis = np.stack([np.ones(len(knots)), knots], axis=1)[:, : 2 if signal == RATE else 1]
    without: Array = np.eye(len(knots)) - basis @ np.linalg.pinv(basis)
    return without


def _question(shape: Shape) -> tuple[str, bool]:
    return shape.signal, shape.of_scale


def stages(searched: Search) -> dict[str, ExaminedModel]:
    """The models that were run with success, by name: as it was, and with each effect that was kept.

    The model as it was is not among them where the filter could not run with it.
    """
    named = {'the model as it was': searched.first}
    named |= {f'with {change.effect.name}': change.after for change in searched.kept}
    lost = any(change.before is None for change in searched.additions)
    return {name: stage for name, stage in named.items() if name != 'the model as it was' or not lost}


def held_out_drifts(searched: Search) -> dict[str, BlindDrift]:
    """Drift on held-out spans by name of the model."""
    reference = reference_path(searched.last.run)
    return {
        name: blind_drift(stage.run, reference, held_out_from_s(stage.run))
        for name, stage in stages(searched).items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class EffectCurve:
    """What a found effect does, with its doubt."""

    x_label: str
    y_label: str
    x: Array
    """(n,)"""
    y: Array
    std: Array


def contribution(finding: MissingEffect) -> EffectCurve | None:
    """What a found effect does against what brings it out; None where the library has no picture of it.

    The doubt is that of the coefficients one by one, as if they were independent.
    """
    effect = find_effect(finding.effect.name)
    if effect.about.shown_against == 'signal':
        return None  # its signal is drawn with what was left over

    def curve(values: Array) -> Array:
        return list(sketch(effect, [tuple(values.tolist())]).lines.values())[-1]

    drawn, y = sketch(effect, [tuple(finding.values.tolist())]), curve(finding.values)
    moved = [curve(finding.values + step) - y for step in np.diag(finding.stds)]
    return EffectCurve(drawn.x_label, drawn.y_label, drawn.x, y, np.sqrt(np.sum(np.square(moved), axis=0)))
