"""Laws that no effect of the library has, as columns for the filter to carry.

All columns ride along in one pass of the filter. From their score statistics follows the marginal likelihood
of every law with every prior, without another run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import (
    Array,
    IntArray,
    MotionBlock,
)
from gyrocal_ros.diagnose.analysis.candidates import columns_of
from gyrocal_ros.diagnose.analysis.heading_filter import headings
from gyrocal_ros.diagnose.analysis.shapes import find_oscillations
from gyrocal_ros.effects.base import LinearGyroEffect
from gyrocal_ros.effects.learned import curve, memory, place_map, step, wave
from gyrocal_ros.effects.learned.curve import LENGTHS as CURVE_LENGTHS
from gyrocal_ros.effects.learned.curve import TYPICAL, Of
from gyrocal_ros.effects.learned.curve import prior_stds as curve_stds
from gyrocal_ros.effects.learned.events import MIN_EVENTS, count_events, events_in
from gyrocal_ros.effects.learned.memory import OF_SCALE, TAUS_S
from gyrocal_ros.effects.learned.place_map import LENGTHS as MAP_LENGTHS
from gyrocal_ros.effects.learned.place_map import prior_stds as map_stds
from gyrocal_ros.effects.learned.signals import HEADING, RATE, to_record
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.model.recording import TEMPERATURE
from gyrocal_ros.model.sensor import Coefficient, Effect

AMPLITUDES = np.geomspace(0.01, 100.0, 17)
"""Prior standard deviations that are tried, relative to the usual one."""
STEP_S, FINE_STEP_S = 10.0, 0.5
"""Distance of the moments that are tried for a step, first and in the second pass."""
MAX_WAVES = 3
"""Number of periods that are tried at once."""
MAX_STEPS = 20
"""Number of moments that are tried at once."""
KINDS: tuple[Of, ...] = ('bias', 'scale')
SLOWEST_S = 150.0
"""Longest period of a wave; a drift or a settling looks like part of a longer one."""
MIN_RAMP, RAMP_PART = 10, 0.03
"""Values from which a signal may be a ramp, and largest deviation (std) of one, as a part of its range."""
MARGIN_M = 0.2
"""Margin of a map around the path."""


@dataclass(frozen=True, slots=True, eq=False)
class Law:
    """A learned effect that may explain a recording."""

    effect: Effect
    carried: Effect
    columns: IntArray
    """(k,) its columns among those of `carried`."""
    shapes: tuple[Array, ...]
    """Prior standard deviations (k,) that are tried, each times every amplitude."""


@dataclass(frozen=True, slots=True, eq=False)
class RankedLaw:
    """A law with the prior that makes the recording likeliest."""

    effect: Effect
    gain: float
    """Marginal log-likelihood gained: that of the measurements with the coefficients integrated out."""


@dataclass(frozen=True)
class StepBank(LinearGyroEffect):
    """A step at each of several moments, for speed."""

    acts_on: ClassVar = 'gyro'
    of: Of
    at_s: tuple[float, ...]
    name: str = 'step bank'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:  # type: ignore[override]
        """One coefficient for each moment."""
        item = step(self.of).coefficients[0]
        return tuple(replace(item, name=f'step_{number}') for number in range(len(self.at_s)))

    def columns(self, block: MotionBlock) -> Array:
        """Return the columns (N, n)."""
        after = (block.time_s[:, None] >= np.array(self.at_s)).astype(float)
        return after * block.rate_rad_s[:, 2:] if self.of == 'scale' else after


def law_names(ranges: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return the names of all laws that can be learned from a recording with these signals."""
    found = [law.effect.name for law in (*_curves(ranges), *_memories(ranges))]
    return [*found, place_map().name, *(make(of).name for make in (step, wave) for of in KINDS)]


def laws(run: Run, ranges: Mapping[str, tuple[float, float]], only: Sequence[str] = ()) -> list[Law]:
    """Return the laws to try beside the model of a run.

    Args:
        run: a finished run, for the path and the duration.
        ranges: range of each signal.
        only: names out of `law_names`; empty for all.
    """
    present = {effect.name for effect in run.model.effects}
    found = [*_curves(ranges), *_memories(ranges), *_map(run), *_steps(run), *_waves(run)]
    excluded = present | {f'{of}_memory:{drive}' for of in KINDS for drive in _excluded_drives(run, ranges)}
    return [law for law in found if law.effect.name not in excluded and (not only or law.effect.name in only)]


def _excluded_drives(run: Run, ranges: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    """Yield recorded signals, and events of them, that are not tried as the drive of a memory.

    These are signals that rise steadily, whose memory is one of the start, and of the events of a signal all
    but its most frequent rise and fall.
    """
    history = run.history
    recorded = dict(zip(run.signal_names, history.signals.T, strict=True))
    recorded[TEMPERATURE] = history.temperature_c
    for name in ranges.keys() & recorded.keys():
        if is_ramp(history.time_s, recorded[name]):
            yield name
        for rises in (True, False):
            events = [event for event in events_in(name, *ranges[name]) if event.rises == rises]
            counts = [count_events(event, recorded[name], history.dt_s) for event in events]
            most = counts.index(max(counts))
            yield from (
                event.drive
                for place, event in enumerate(events)
                if place != most or counts[most] < MIN_EVENTS
            )


def is_ramp(time_s: Array, values: Array) -> bool:
    """Return True if a signal (n,), NaN where it is not recorded, is a straight line over time."""
    known = np.isfinite(values)
    if np.count_nonzero(known) < MIN_RAMP or np.ptp(values[known]) == 0.0:
        return False
    line = np.polynomial.Polynomial.fit(time_s[known], values[known], 1)
    left = float(np.std(values[known] - line(time_s[known])))
    return left < RAMP_PART * float(np.ptp(values[known]))


def fine_steps(of: Of, at_s: float, half_s: float) -> list[Law]:
    """Return steps at moments close to one."""
    return _steps_at(of, np.arange(at_s - half_s, at_s + half_s, FINE_STEP_S))


def carried_by(tried: Sequence[Law]) -> tuple[Effect, ...]:
    """Return the effects that the filter has to carry for some laws, each once."""
    return tuple({id(law.carried): law.carried for law in tried}.values())


def rank_laws(tried: Sequence[Law], scores: ScoreStatistics) -> list[RankedLaw]:
    """Return the laws with their best priors, the likeliest first.

    Args:
        tried: laws.
        scores: score statistics of a run that carried them, see `carried_by`.
    """
    places = {
        id(effect): columns
        for effect, columns in zip(carried_by(tried), columns_of(scores.candidates), strict=True)
    }
    information, score = scores.information.sum(axis=0), scores.score.sum(axis=0)
    ranked = []
    for law in tried:
        at = places[id(law.carried)][law.columns]
        stds, gain = _best_prior(information[np.ix_(at, at)], score[at], law.shapes)
        items = tuple(
            replace(item, prior_std=float(std))
            for item, std in zip(law.effect.coefficients, stds, strict=True)
        )
        ranked.append(RankedLaw(replace(law.effect, coefficients=items), gain))  # type: ignore[type-var]
    return sorted(ranked, key=lambda item: item.gain, reverse=True)


def _best_prior(information: Array, score: Array, shapes: Sequence[Array]) -> tuple[Array, float]:
    """Return the prior standard deviations (k,) with the largest marginal likelihood, and its logarithm.

    With the prior P = D^2, it gains `1/2 b^T D (1 + D Lambda D)^-1 D b - 1/2 log det (1 + D Lambda D)`.
    """
    best = shapes[0], -math.inf
    for shape in shapes:
        curvature, axes = np.linalg.eigh(shape[:, None] * information * shape)
        along = axes.T @ (shape * score)
        grown = np.square(AMPLITUDES)[:, None] * np.maximum(curvature, 0.0)
        gains = 0.5 * np.square(AMPLITUDES)[:, None] * np.square(along) / (1.0 + grown) - 0.5 * np.log1p(
            grown
        )
        total = gains.sum(axis=1)
        place = int(total.argmax())
        if total[place] > best[1]:
            best = shape * AMPLITUDES[place], float(total[place])
    return best


def _law(effect: Effect, shapes: Sequence[Array]) -> Law:
    return Law(effect, effect, np.arange(len(effect.coefficients)), tuple(shapes))


def _curves(ranges: Mapping[str, tuple[float, float]]) -> Iterator[Law]:
    for of in KINDS:
        for name, (low, high) in (dict(ranges) | {HEADING: (-np.pi, np.pi)}).items():
            if of == 'scale' and name == RATE:
                continue
            shapes = [curve_stds(name, TYPICAL[of], length) for length in CURVE_LENGTHS]
            yield _law(curve(of, name, low, high), shapes)


def _memories(ranges: Mapping[str, tuple[float, float]]) -> Iterator[Law]:
    recorded = [name for name in ranges if to_record(name)]
    events = [event.drive for name in recorded for event in events_in(name, *ranges[name])]
    effects = [memory('bias', drive) for drive in (*TAUS_S, *recorded, *events)]
    effects += [memory('scale', drive) for drive in (*OF_SCALE, *recorded, *events)]
    for effect in effects:
        yield _law(effect, [np.array([item.prior_std for item in effect.coefficients])])


def _map(run: Run) -> Iterator[Law]:
    position = run.history.mean[:, :2]
    low, high = position.min(axis=0) - MARGIN_M, position.max(axis=0) + MARGIN_M
    effect = place_map(low_m=tuple(low.tolist()), high_m=tuple(high.tolist()))
    yield _law(effect, [map_stds(TYPICAL['bias'], length) for length in MAP_LENGTHS])


def _steps(run: Run) -> Iterator[Law]:
    duration_s = float(run.history.time_s[-1])
    apart_s = max(STEP_S, duration_s / MAX_STEPS)
    for of in KINDS:
        yield from _steps_at(of, np.arange(apart_s, duration_s - 0.5 * apart_s, apart_s))


def _steps_at(of: Of, at_s: Array) -> list[Law]:
    bank = StepBank(of, tuple(at_s.tolist()))
    return [
        Law(step(of, at_s=moment), bank, np.array([number]), (np.array([TYPICAL[of]]),))
        for number, moment in enumerate(bank.at_s)
    ]


def _waves(run: Run) -> Iterator[Law]:
    """Yield waves with the periods that explain most of the headings."""
    seen = headings(run)
    for of in KINDS:
        for period_s, _ in find_oscillations(seen, of, SLOWEST_S, MAX_WAVES):
            effect = wave(of, period_s=period_s)
            yield _law(effect, [np.array([item.prior_std for item in effect.coefficients])])
