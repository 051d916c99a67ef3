"""Unexplained structure: what the rate error follows, whatever the physics.

Bias or scale as a free piecewise linear function of anything recorded; a jump of the bias; an oscillating
bias.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit, fit
from gyrocal_ros.diagnose.analysis.heading_filter import TURNING_RAD_S, Headings, heading_scores, misfits
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.effects.learned.curve import Of
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import YAW
from gyrocal_ros.statistics import chi_square_tail, robust_std, sigma_of

KNOTS = 5
"""Number of knots over a recorded signal."""
TIME_KNOT_S = 30.0
"""Distance of the knots over time."""
LEAST_TURNED_RAD = 2.0 * math.pi
"""Total turn up to which a run says nothing of changes of the scale, or of errors that go with the rate."""
JUMP_STEP_S = 2.0
"""Resolution of the moment of a jump."""
MAX_AT_ONCE = 150
"""Number of moments or frequencies tried at once; memory grows with its square. Long recordings are searched
coarsely first."""
FASTEST_S, SLOWEST_S = 10.0, 60.0
"""Range of periods of an oscillating bias; a slower oscillation shows as a function of time."""
TIME = 'time since the start (s)'
RATE = 'rate (deg/s)'
HEADING = 'heading in the map (deg)'
TEMPERATURE_C = 'temperature (deg C)'
FORCE = 'acceleration (m/s^2)'
DYNAMICS = 'changes of the rate'
HEADING_KNOTS_DEG = np.arange(-180.0, 180.0, 60.0)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorShape:
    """The rate error as a function of one signal."""

    signal: str
    of_scale: bool
    """True for an error of the scale (1), False for one of the bias (rad/s)."""
    knots: Array
    """(k,) values of the signal."""
    values: Array
    stds: Array
    """(k,) error at the knots relative to the first one, and its standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape(ErrorShape):
    """That of a run, as it was fitted to the headings."""

    columns: Array
    """(s, q) rate error of each step per unit of what was fitted, an error of the scale factor included."""
    fit: Fit


@dataclass(frozen=True, slots=True, eq=False)
class UnexplainedStructure:
    """A rate error that goes with something recorded, whatever causes it."""

    what: str
    """Description for people."""
    gain: float
    """Log-likelihood that knowing it would gain."""
    sigma: float
    shape: ErrorShape
    at_s: float | None = None
    """Moment of the jump, if it is a jump of the bias."""
    is_confirmed: bool = False
    """True if a run with a law for it predicts the recording better."""


def unexplained_structure(
    run: Run, seen: Headings, settings: DiagnosisSettings
) -> UnexplainedStructure | None:
    """Return the structure that explains most of what is left over; None where all of it may be chance."""
    found = _structures(seen, shapes(run, seen), settings)
    best = max(found, key=lambda item: item[0], default=(0.0, None))[1]
    return best if best is not None and best.sigma > settings.structure_sigma else None


def confirmed(
    structure: UnexplainedStructure | None, most_gained: float, settings: DiagnosisSettings
) -> UnexplainedStructure | None:
    """Return the structure if the full filter sees it too: an effect of the gyro then explains some of it.

    The headings alone cannot distinguish structure from errors of the map, which change with its features;
    effects of the camera explain a part of these.

    Args:
        structure: structure by the headings.
        most_gained: log-likelihood that the best effect of the gyro gains in the full filter.
        settings: thresholds.
    """
    if structure is None:
        return None
    least = min(settings.structure_shown_part * structure.gain, settings.structure_shown_gain)
    return structure if most_gained >= least else None


def shapes(run: Run, seen: Headings) -> list[Shape]:
    """Fit the rate error as a function of each signal; the one that explains most comes first.

    A signal that drifts slowly fits anything that drifts slowly.
    """
    rate = run.history.turn_rad / run.history.dt_s
    # On a straight line the rate is noise; removing noise would look like an error of the scale.
    turning = np.where(np.abs(rate) > TURNING_RAD_S, rate, 0.0)
    turns = turns_enough(run)
    tried = [
        (name, of_scale, knots, parts * turning[:, None] if of_scale else parts)
        for name, values in axes(run)
        for knots, parts in _hats(values, name)
        for of_scale in (False, True)
        if not (of_scale and name in (RATE, HEADING)) and (turns or not (of_scale or name == RATE))
    ]
    scores = heading_scores(seen, np.concatenate([rate[:, None], *(item[3] for item in tried)], axis=1))
    found, start = [], 1
    for name, of_scale, knots, columns in tried:
        end = start + columns.shape[1]
        fitted = fit(scores, np.arange(start, end), given=np.array([0]))
        if fitted is not None:
            values, stds = np.full((2, len(knots)), np.nan)
            values[0] = stds[0] = 0.0
            places = fitted.columns - start + 1
            values[places], stds[places] = fitted.values, np.sqrt(np.diagonal(fitted.covariance))
            used = np.concatenate([rate[:, None], columns[:, fitted.columns - start]], axis=1)
            found.append(Shape(name, of_scale, knots, values, stds, used, fitted))
        start = end
    return sorted(found, key=lambda shape: shape.fit.gain - len(shape.fit.values), reverse=True)


def turns_enough(run: Run) -> bool:
    """Return True if a run can tell changes of the scale: the first turn determines the scale factor."""
    return sum(run.history.turned_rad(TURNING_RAD_S)) > LEAST_TURNED_RAD


def axes(run: Run) -> Iterator[tuple[str, Array]]:
    """Yield name and values (s,) of everything that the rate error may follow."""
    history = run.history
    yield TIME, history.time_s
    yield RATE, np.degrees(history.turn_rad / history.dt_s)
    yield HEADING, np.degrees(history.mean[:, YAW])
    yield TEMPERATURE_C, history.temperature_c
    yield FORCE, history.forward_m_s2
    for place, name in enumerate(run.signal_names):
        yield name, history.signals[:, place]


def hats(values: Array, knots: Array, name: str) -> Array:
    """Return hat functions (s, k) with the given knots (k,) at the values (s,) of a signal of that name."""
    period = 360.0 if name == HEADING else None
    return np.stack([np.interp(values, knots, row, period=period) for row in np.eye(len(knots))], axis=1)


def find_jump(seen: Headings) -> tuple[float, Fit] | None:
    """Return the moment (s) at which a jump of the bias explains most, and its fit."""
    first_s, last_s = 2.0 * JUMP_STEP_S, float(seen.time_s[-1]) - 2.0 * JUMP_STEP_S
    apart_s = max(JUMP_STEP_S, (last_s - first_s) / MAX_AT_ONCE)
    found = _best_jump(seen, np.arange(first_s, last_s, apart_s))
    if found is None or apart_s == JUMP_STEP_S:
        return found
    return _best_jump(seen, np.arange(max(found[0] - apart_s, first_s), found[0] + apart_s, JUMP_STEP_S))


def find_oscillation(seen: Headings) -> tuple[float, Fit] | None:
    """Return the period (s) of the oscillation of the bias that explains most, and its fit."""
    return next(iter(find_oscillations(seen, 'bias', SLOWEST_S, most=1)), None)


def find_oscillations(seen: Headings, of: Of, slowest_s: float, most: int) -> list[tuple[float, Fit]]:
    """Return the periods (s) of the oscillations that explain most, and the fits of sine and cosine.

    Each explains more than its neighbours: an error that the filter partly follows has several such periods,
    and not always the best of them is that of the cause.

    Args:
        seen: headings.
        of: what oscillates.
        slowest_s: longest period; half the recording at most.
        most: number of periods at most.
    """
    slowest_hz, fastest_hz = 1.0 / slowest_s, 1.0 / FASTEST_S
    apart_hz = 0.5 / float(seen.time_s[-1])
    coarse = _oscillations(seen, np.arange(max(slowest_hz, 4.0 * apart_hz), fastest_hz, apart_hz), of)
    gains = np.array([-np.inf, *(fitted.gain for _, fitted in coarse), -np.inf])
    peaks = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]))
    highest = sorted(peaks.tolist(), key=lambda place: coarse[place][1].gain, reverse=True)[:most]
    around = apart_hz * np.linspace(-1.0, 1.0, 21)
    return [
        max(_oscillations(seen, 1.0 / coarse[place][0] + around, of), key=lambda item: item[1].gain)
        for place in highest
    ]


def _structures(
    seen: Headings, found: list[Shape], settings: DiagnosisSettings
) -> Iterator[tuple[float, UnexplainedStructure]]:
    """Yield structures with their merit: the gain less one for each fitted number."""
    for shape in found[:1]:
        kind, count = 'scale' if shape.of_scale else 'bias', len(shape.fit.values)
        sigma = _sigma(seen, shape.fit, shape.columns, count, settings)
        what = f'the {kind} goes with {shape.signal}'
        yield shape.fit.gain - count, UnexplainedStructure(what, shape.fit.gain, sigma, shape)
    for shape in found:
        if shape.signal == TIME and not shape.of_scale:
            yield from _over_time(seen, shape, settings)


def _over_time(
    seen: Headings, shape: Shape, settings: DiagnosisSettings
) -> Iterator[tuple[float, UnexplainedStructure]]:
    jump, oscillation = find_jump(seen), find_oscillation(seen)
    if jump is not None:
        at_s, fitted = jump
        sigma = _sigma(seen, fitted, _after(seen, np.array([at_s])), 2, settings)
        what = f'the bias jumped by {math.degrees(float(fitted.values[0])):+.3f} deg/s at {at_s:.0f} s'
        yield fitted.gain - 2.0, UnexplainedStructure(what, fitted.gain, sigma, shape, at_s)
    if oscillation is not None:
        period_s, fitted = oscillation
        sigma = _sigma(seen, fitted, _waves(seen, np.array([1.0 / period_s]), 'bias'), 3, settings)
        size = f'{math.degrees(float(np.hypot(*fitted.values))):.3f} deg/s'
        what = f'the bias oscillates with an amplitude of {size} and a period of {period_s:.1f} s'
        merit = settings.oscillation_part * fitted.gain - 3.0
        yield merit, UnexplainedStructure(what, fitted.gain, sigma, shape)


def _best_jump(seen: Headings, at_s: Array) -> tuple[float, Fit] | None:
    return _best(seen, at_s.tolist(), _after(seen, at_s)) if len(at_s) else None


def _oscillations(seen: Headings, hz: Array, of: Of) -> list[tuple[float, Fit]]:
    """Return the periods (s) of frequencies with a fit, and these, in the order of the frequencies."""
    parts = np.array_split(hz, max(math.ceil(2 * len(hz) / MAX_AT_ONCE), 1))
    return [
        item
        for part in parts
        if len(part)
        for item in _fits(seen, (1.0 / part).tolist(), _waves(seen, part, of))
    ]


def _best(seen: Headings, parameters: list[float], columns: Array) -> tuple[float, Fit] | None:
    """Return the parameter whose columns explain most, and their fit, see `_fits`."""
    return max(_fits(seen, parameters, columns), key=lambda item: item[1].gain, default=None)


def _fits(seen: Headings, parameters: list[float], columns: Array) -> list[tuple[float, Fit]]:
    """Return the parameters (of n) whose columns have a fit, and these.

    Args:
        seen: headings.
        parameters: n values.
        columns: (s, n q) the first column of each value, then the second of each, up to q.
    """
    scores, count = heading_scores(seen, columns), len(parameters)
    places = [np.arange(place, columns.shape[1], count) for place in range(count)]
    fits = [(value, fit(scores, place)) for value, place in zip(parameters, places, strict=True)]
    return [(value, fitted) for value, fitted in fits if fitted is not None]


def _after(seen: Headings, at_s: Array) -> Array:
    """Return steps (s, n): zero before each moment, one after."""
    return (seen.time_s[:, None] >= at_s).astype(float)


def _waves(seen: Headings, hz: Array, of: Of) -> Array:
    """Return (s, 2 n): the sines, then the cosines; for a scale, times the rate."""
    phase = 2.0 * np.pi * seen.time_s[:, None] * hz
    waves = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
    return waves * (seen.turn_rad / seen.dt_s)[:, None] if of == 'scale' else waves


def _sigma(seen: Headings, fitted: Fit, columns: Array, dof: int, settings: DiagnosisSettings) -> float:
    """Return the significance of a fit by the scatter that it leaves, where that exceeds the filter's own.

    The scatter is a median over the blocks of time, so that a few blocks with another error do not hide it.
    """
    scatter = robust_std(misfits(seen, columns))
    inflation = max(settings.min_inflation, scatter**2)
    return sigma_of(chi_square_tail(2.0 * fitted.gain / inflation, dof))


def _hats(values: Array, name: str) -> Iterator[tuple[Array, Array]]:
    """Yield knots (k,) and hat functions (s, k - 1) of a signal; nothing for one that does not vary."""
    if name == HEADING:
        yield HEADING_KNOTS_DEG, hats(values, HEADING_KNOTS_DEG, name)[:, 1:]
        return
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return
    if name == TIME:
        count = max(round(float(np.ptp(known)) / TIME_KNOT_S) + 1, 2)
        knots = np.linspace(known.min(), known.max(), count)
    else:
        low, high = np.quantile(known, (0.02, 0.98)).tolist()
        knots = np.linspace(low, high, KNOTS)
    if np.ptp(knots) <= 1e-9 * np.abs(knots).max():
        return
    filled = np.where(np.isfinite(values), values, knots[0])
    yield knots, hats(filled, knots, name)[:, 1:]
