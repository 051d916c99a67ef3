"""Shapes that are no physics: how something outside the library shows itself.

Bias or scale as a free function of anything recorded, straight between knots; the bias as a jump, or
swinging to and fro.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.candidate_fit import Fit, chi_square_tail, fit, sigma_of
from gyrocal_ros.diagnose.heading_filter import TURNING_RAD_S, Headings, heading_scores, misfits
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.state import YAW

KNOTS = 5
TIME_KNOT_S = 30.0
STEP_S = 2.0
"""How finely the moment of a jump is told."""
MOST_MOMENTS = 150
"""Asked at a time: what they say together takes memory as their square. A long recording is asked twice."""
SWING_S = (10.0, 60.0)
"""Periods with which the bias may swing; slower ones show as a function of time."""
SWING_PART = 0.8
"""What is recorded and explains so much of what a swing does is believed before it."""
INFLATION = 2.0
"""The filter's own idea of chance is too narrow by this at least, as a variance: a bias wanders by itself."""
ODD_SIGMA = 6.0
"""Below this an oddity counts as chance: shapes are many and bend freely."""
TIME = 'time since the start (s)'
RATE = 'rate (deg/s)'
HEADING = 'heading in the map (deg)'
HEADING_KNOTS_DEG = np.arange(-180.0, 180.0, 60.0)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """What a run leaves over, as a function of one signal."""

    signal: str
    of_scale: bool
    """Of the scale (1), else of the bias (rad/s)."""
    knots: Array
    """(k,) of the signal."""
    values: Array
    stds: Array
    """(k,) at the knots less that at the first one, which has none."""
    columns: Array
    """(s, q) rate error of each step per unit of what was fitted, a false scale factor among it."""
    fit: Fit


@dataclass(frozen=True, slots=True, eq=False)
class UnexplainedStructure:
    """Something left over that goes with something recorded, whatever it is."""

    what: str
    """In plain words."""
    gain: float
    """Log-likelihood that knowing it would gain."""
    sigma: float
    shape: Shape
    at_s: float | None = None
    """When, where the bias jumped."""


def unexplained_structure(run: Run, seen: Headings) -> UnexplainedStructure | None:
    """The shape that explains most of what is left over, where it is more than chance."""
    odd = max(_oddities(seen, shapes(run, seen)), key=lambda item: item[0], default=(0.0, None))[1]
    return odd if odd is not None and odd.sigma > ODD_SIGMA else None


def _oddities(seen: Headings, found: list[Shape]) -> Iterator[tuple[float, UnexplainedStructure]]:
    """What may be odd, with its merit: what it gains, less one for every number that it takes."""
    for shape in found[:1]:
        kind, numbers = 'scale' if shape.of_scale else 'bias', len(shape.fit.values)
        sigma = _sigma(seen, shape.fit, shape.columns, numbers)
        what = f'the {kind} goes with {shape.signal}'
        yield shape.fit.gain - numbers, UnexplainedStructure(what, shape.fit.gain, sigma, shape)
    for shape in found:
        if shape.signal == TIME and not shape.of_scale:
            yield from _over_time(seen, shape)


def _over_time(seen: Headings, shape: Shape) -> Iterator[tuple[float, UnexplainedStructure]]:
    jumped, swung = jump(seen), swing(seen)
    if jumped is not None:
        at_s, fitted = jumped
        sigma = _sigma(seen, fitted, _after(seen, np.array([at_s])), 2)
        what = f'the bias jumped by {math.degrees(float(fitted.values[0])):+.3f} deg/s at {at_s:.0f} s'
        yield fitted.gain - 2.0, UnexplainedStructure(what, fitted.gain, sigma, shape, at_s)
    if swung is not None:
        period_s, fitted = swung
        sigma = _sigma(seen, fitted, _waves(seen, np.array([1.0 / period_s])), 3)
        size = f'{math.degrees(float(np.hypot(*fitted.values))):.3f} deg/s'
        what = f'the bias swings by {size} to either side, once in {period_s:.1f} s'
        yield SWING_PART * fitted.gain - 3.0, UnexplainedStructure(what, fitted.gain, sigma, shape)


def shapes(run: Run, seen: Headings) -> list[Shape]:
    """The error of the rate as a function of each signal, the one that explains most first.

    A signal that wanders slowly fits anything that wanders slowly.
    """
    rate = run.history.turn_rad / run.history.dt_s
    # On a straight line the rate is noise, and to take noise away would pass for a false scale.
    turning = np.where(np.abs(rate) > TURNING_RAD_S, rate, 0.0)
    asked = [
        (name, of_scale, knots, parts * turning[:, None] if of_scale else parts)
        for name, values in axes(run)
        for knots, parts in _hats(values, name)
        for of_scale in (False, True)
        if not (of_scale and name in (RATE, HEADING))
    ]
    scores = heading_scores(seen, np.concatenate([rate[:, None], *(item[3] for item in asked)], axis=1))
    found, start = [], 1
    for name, of_scale, knots, columns in asked:
        end = start + columns.shape[1]
        fitted = fit(scores, np.arange(start, end), given=np.array([0]))
        if fitted is not None:
            values, stds = np.full((2, len(knots)), np.nan)
            values[0] = stds[0] = 0.0
            places = fitted.columns - start + 1
            values[places], stds[places] = fitted.values, np.sqrt(np.diagonal(fitted.covariance))
            bent = np.concatenate([rate[:, None], columns[:, fitted.columns - start]], axis=1)
            found.append(Shape(name, of_scale, knots, values, stds, bent, fitted))
        start = end
    return sorted(found, key=lambda shape: shape.fit.gain - len(shape.fit.values), reverse=True)


def jump(seen: Headings) -> tuple[float, Fit] | None:
    """The moment at which a jump of the bias explains most, and what it explains."""
    first_s, last_s = 2.0 * STEP_S, float(seen.time_s[-1]) - 2.0 * STEP_S
    apart_s = max(STEP_S, (last_s - first_s) / MOST_MOMENTS)
    found = _best_jump(seen, np.arange(first_s, last_s, apart_s))
    if found is None or apart_s == STEP_S:
        return found
    return _best_jump(seen, np.arange(max(found[0] - apart_s, first_s), found[0] + apart_s, STEP_S))


def swing(seen: Headings) -> tuple[float, Fit] | None:
    """The period (s) with which a swinging bias explains most, and what it explains: sine and cosine."""
    fastest_hz, slowest_hz = (1.0 / period_s for period_s in SWING_S)
    apart_hz = 0.5 / float(seen.time_s[-1])
    found = _best_swing(seen, np.arange(max(slowest_hz, 4.0 * apart_hz), fastest_hz, apart_hz))
    if found is None:
        return None
    return _best_swing(seen, 1.0 / found[0] + apart_hz * np.linspace(-1.0, 1.0, 21))


def _best_jump(seen: Headings, at_s: Array) -> tuple[float, Fit] | None:
    return _best(seen, at_s.tolist(), _after(seen, at_s)) if len(at_s) else None


def _best_swing(seen: Headings, hz: Array) -> tuple[float, Fit] | None:
    parts = np.array_split(hz, max(math.ceil(2 * len(hz) / MOST_MOMENTS), 1))
    found = [_best(seen, (1.0 / part).tolist(), _waves(seen, part)) for part in parts if len(part)]
    told = [item for item in found if item is not None]
    return max(told, key=lambda item: item[1].gain, default=None)


def _best(seen: Headings, names: list[float], columns: Array) -> tuple[float, Fit] | None:
    """The best of several questions; columns (s, n q), one of each question, then the next of each."""
    scores, count = heading_scores(seen, columns), len(names)
    places = [np.arange(place, columns.shape[1], count) for place in range(count)]
    fits = [(name, fit(scores, place)) for name, place in zip(names, places, strict=True)]
    told = [(name, fitted) for name, fitted in fits if fitted is not None]
    return max(told, key=lambda item: item[1].gain, default=None)


def _after(seen: Headings, at_s: Array) -> Array:
    """(s, n): zero before each moment, one after."""
    return (seen.time_s[:, None] >= at_s).astype(float)


def _waves(seen: Headings, hz: Array) -> Array:
    """(s, 2 n): the sines, then the cosines."""
    phase = 2.0 * np.pi * seen.time_s[:, None] * hz
    return np.concatenate([np.sin(phase), np.cos(phase)], axis=1)


def _sigma(seen: Headings, fitted: Fit, columns: Array, dof: int) -> float:
    """Significance of a fit, by the scatter that it leaves where that is more than the filter expects.

    The median over the blocks of time, so that a few that are off for a reason do not hide it.
    """
    scatter = 1.4826 * float(np.median(np.abs(misfits(seen, columns))))
    return sigma_of(chi_square_tail(2.0 * fitted.gain / max(INFLATION, scatter**2), dof))


def axes(run: Run) -> Iterator[tuple[str, Array]]:
    """What is recorded (s,), by name."""
    history = run.history
    yield TIME, history.time_s
    yield RATE, np.degrees(history.turn_rad / history.dt_s)
    yield HEADING, np.degrees(history.mean[:, YAW])
    yield 'temperature (deg C)', history.temperature_c
    yield 'acceleration (m/s^2)', history.forward_m_s2
    for place, name in enumerate(run.signal_names):
        yield name, history.signals[:, place]


def _hats(values: Array, name: str) -> Iterator[tuple[Array, Array]]:
    """Knots (k,) and hat functions (s, k - 1) of a signal; nothing for one that does not vary."""
    if name == HEADING:
        yield HEADING_KNOTS_DEG, hats(values, HEADING_KNOTS_DEG, name)[:, 1:]
        return
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return
    count = max(round(float(np.ptp(known)) / TIME_KNOT_S) + 1, 2) if name.startswith('time') else KNOTS
    if name.startswith('time'):
        knots = np.linspace(known.min(), known.max(), count)
    else:
        low, high = np.quantile(known, (0.02, 0.98)).tolist()
        knots = np.linspace(low, high, count)
    if np.ptp(knots) <= 1e-9 * np.abs(knots).max():
        return
    filled = np.where(np.isfinite(values), values, knots[0])
    yield knots, hats(filled, knots, name)[:, 1:]


def hats(values: Array, knots: Array, name: str) -> Array:
    """(s, k): how much of each knot of a signal of that name there is in its values (s,)."""
    period = 360.0 if name == HEADING else None
    return np.stack([np.interp(values, knots, row, period=period) for row in np.eye(len(knots))], axis=1)
