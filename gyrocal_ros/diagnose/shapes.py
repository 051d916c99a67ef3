"""Shapes that are no physics: how something outside the library shows itself.

Bias or scale as a free function of anything recorded, straight between knots; the bias as a jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.diagnose.evidence import Fit, chi_square_tail, fit, sigma_of
from gyrocal_ros.diagnose.heading import TURNING_RAD_S, Headings, heading_evidence, misfits
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.model.sensor import Coefficient

KNOTS = 5
TIME_KNOT_S = 30.0
STEP_S = 2.0
"""How finely the moment of a jump is told."""
INFLATION = 2.0
"""The filter's own idea of chance is too narrow by this at least, as a variance: a bias wanders by itself."""
ODD_SIGMA = 6.0
"""Below this an oddity counts as chance: shapes are many and bend freely."""
TIME = 'time since the start (s)'
RATE = 'rate (deg/s)'


@dataclass(frozen=True)
class BiasStep(LinearGyroEffect):
    """The bias jumps at a moment, as after a knock."""

    at_s: float
    name: str
    coefficients: tuple[Coefficient, ...]

    def columns(self, block: MotionBlock) -> Array:
        """(N, 1): zero before, one after."""
        return column((block.time_s >= self.at_s).astype(float))


def bias_step(at_s: float) -> BiasStep:
    """A jump of the bias at `at_s` after the first IMU sample."""
    return BiasStep(at_s, f'bias_step:{at_s:.0f}', (Coefficient('k', 'rad/s', math.radians(0.1)),))


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
class Oddity:
    """Something left over that goes with something recorded, whatever it is."""

    what: str
    """In plain words."""
    gain: float
    """Log-likelihood that knowing it would gain."""
    sigma: float
    shape: Shape
    at_s: float | None = None
    """When, where the bias jumped."""


def oddity(run: Run, seen: Headings) -> Oddity | None:
    """The shape that explains most of what is left over, where it is more than chance."""
    found = shapes(run, seen)
    if not found:
        return None
    shape = found[0]
    jumped = jump(seen)
    if jumped is not None and jumped[1].gain - 2.0 > shape.fit.gain - len(shape.fit.values):
        at_s, fitted = jumped
        columns = (seen.time_s >= at_s).astype(float)[:, None]
        sigma = _sigma(seen, fitted, columns, 2)
        size = f'{math.degrees(float(fitted.values[0])):+.3f} deg/s'
        shape = next(item for item in found if item.signal == TIME and not item.of_scale)
        odd = Oddity(f'the bias jumped by {size} at {at_s:.0f} s', fitted.gain, sigma, shape, at_s)
    else:
        kind = 'scale' if shape.of_scale else 'bias'
        sigma = _sigma(seen, shape.fit, shape.columns, len(shape.fit.values))
        odd = Oddity(f'the {kind} goes with {shape.signal}', shape.fit.gain, sigma, shape)
    return odd if odd.sigma > ODD_SIGMA else None


def shapes(run: Run, seen: Headings) -> list[Shape]:
    """The error of the rate as a function of each signal, the one that explains most first.

    A signal that wanders slowly fits anything that wanders slowly.
    """
    rate = run.history.turn_rad / run.history.dt_s
    # On a straight line the rate is noise, and to take noise away would pass for a false scale.
    turning = np.where(np.abs(rate) > TURNING_RAD_S, rate, 0.0)
    asked = [
        (name, of_scale, knots, hats * turning[:, None] if of_scale else hats)
        for name, values in _axes(run)
        for knots, hats in _hats(values, name)
        for of_scale in (False, True)
        if not (of_scale and name == RATE)
    ]
    evidence = heading_evidence(seen, np.concatenate([rate[:, None], *(item[3] for item in asked)], axis=1))
    found, start = [], 1
    for name, of_scale, knots, columns in asked:
        end = start + columns.shape[1]
        fitted = fit(evidence, np.arange(start, end), given=np.array([0]))
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
    moments = np.arange(2.0 * STEP_S, seen.time_s[-1] - 2.0 * STEP_S, STEP_S)
    if not len(moments):
        return None
    evidence = heading_evidence(seen, (seen.time_s[:, None] >= moments).astype(float))
    fits = [(at_s, fit(evidence, np.array([place]))) for place, at_s in enumerate(moments.tolist())]
    told = [(at_s, fitted) for at_s, fitted in fits if fitted is not None]
    return max(told, key=lambda item: item[1].gain) if told else None


def _sigma(seen: Headings, fitted: Fit, columns: Array, dof: int) -> float:
    """Significance of a fit, by the scatter that it leaves where that is more than the filter expects.

    The median over the blocks of time, so that a few that are off for a reason do not hide it.
    """
    scatter = 1.4826 * float(np.median(np.abs(misfits(seen, columns))))
    return sigma_of(chi_square_tail(2.0 * fitted.gain / max(INFLATION, scatter**2), dof))


def _axes(run: Run) -> Iterator[tuple[str, Array]]:
    """What is recorded (s,), by name."""
    history = run.history
    yield TIME, history.time_s
    yield RATE, np.degrees(history.turn_rad / history.dt_s)
    yield 'temperature (deg C)', history.temperature_c
    yield 'acceleration (m/s^2)', history.forward_m_s2
    for place, name in enumerate(run.signal_names):
        yield name, history.signals[:, place]


def _hats(values: Array, name: str) -> Iterator[tuple[Array, Array]]:
    """Knots (k,) and hat functions (s, k - 1) of a signal; nothing for one that does not vary."""
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
    yield knots, np.stack([np.interp(filled, knots, row) for row in np.eye(len(knots))[1:]], axis=1)
