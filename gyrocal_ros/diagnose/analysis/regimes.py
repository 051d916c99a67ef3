"""Places where a model fails: stretches of time, and regimes of everything recorded."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.heading_filter import TURNING_RAD_S, Headings, heading_scores, misfits
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S
from gyrocal_ros.statistics import robust_std

RATE_EDGES_DEG_S = (5.0, 20.0, 40.0, 60.0, 80.0, math.inf)
"""Edges of the regimes of the rate."""
SIDES = {'left': 1.0, 'right': -1.0}
TURN_EDGE_RAD_S2 = math.radians(30.0)
"""Angular acceleration above which a turn begins or ends."""
SPEEDING_UP_M_S2 = 0.15
"""Acceleration above which the robot speeds up or brakes."""
SINCE_TURN_S = (0.0, 2.0, 5.0, 10.0, 20.0, math.inf)
SINCE_TURN_M = (0.0, 0.3, 1.0, 2.0, math.inf)
"""Edges of the regimes of time and distance since the last turn."""
MAX_CHANCE = 3.0
"""Largest error of most regimes, in standard deviations, that counts as chance where nothing is missing."""
PARTS = 4
"""Number of parts of equal duration into which the range of a signal is cut."""


@dataclass(frozen=True, slots=True)
class Failure:
    """One place where the model is off by more than chance."""

    what: str
    """Description for people, with the correction that the gyro needs."""
    sigma: float
    from_s: float | None = None
    to_s: float | None = None
    """The stretch of time; None for a regime."""
    regime: str | None = None
    """The regime; None for a stretch of time."""


@dataclass(frozen=True, slots=True, eq=False)
class Regime:
    """Some steps of a run, and the kind of error to test for in them."""

    name: str
    column: np.ndarray
    """(s,) rate error per unit: 1 for an error of the rate (rad/s), the rate for one of the scale."""
    of_scale: bool = False
    is_motion: bool = True
    """True for a regime of the motion, False for one of a slowly changing signal."""


def failures(
    run: Run, seen: Headings, settings: DiagnosisSettings = DEFAULT_SETTINGS, *, is_complete: bool = False
) -> list[Failure]:
    """Find where turns by the gyro and headings by the camera differ by more than chance, worst first.

    The gyro has the final coefficients and a bias that drifts as slowly as the settings say. Chance is
    estimated from the difference of neighbouring blocks of time after everything that motion explains has
    been fitted. If nothing is missing, the errors of most regimes are chance, too: slow errors of the images
    hardly show in the difference of blocks.

    Args:
        run: with the model.
        seen: its headings.
        settings: thresholds.
        is_complete: True if the model lacks nothing.
    """
    every = [regime for regime in regimes(run) if _length_s(regime, seen) > settings.failure_length_s]
    by_motion = np.stack([regime.column for regime in every if regime.is_motion], axis=1).astype(float)
    errors = _errors(every, seen)
    chance = max(1.0, robust_std(np.diff(misfits(seen, by_motion))) / math.sqrt(2.0))
    if is_complete and errors:
        by_regimes = robust_std(np.array([sigma for _, _, sigma in errors]))
        chance = max(chance, min(by_regimes, MAX_CHANCE))
    found = [*_in_regimes(errors, chance, settings), *_in_time(seen, chance, settings)]
    return sorted(found, key=lambda failure: failure.sigma, reverse=True)


def regimes(run: Run) -> Iterator[Regime]:
    """Yield every regime of the recording."""
    history = run.history
    rate = history.turn_rad / history.dt_s
    yield from _of_rate(np.degrees(rate))
    change = np.gradient(rate, history.time_s) if len(rate) > 1 else np.zeros_like(rate)
    yield Regime('turns beginning (+) and ending (-)', np.sign(change) * (np.abs(change) > TURN_EDGE_RAD_S2))
    turning = np.abs(rate) > TURNING_RAD_S
    straight = ~turning & (history.resting == 0)
    force = history.forward_m_s2 - np.median(history.forward_m_s2)
    yield Regime('speeding up', straight & (force > SPEEDING_UP_M_S2))
    yield Regime('braking', straight & (force < -SPEEDING_UP_M_S2))
    last = np.maximum.accumulate(np.where(turning, np.arange(len(rate)), -1))
    after = ~turning & (last >= 0)
    travelled_m = np.cumsum(np.abs(history.distance_m))
    for unit, axis, edges in (('s', history.time_s, SINCE_TURN_S), ('m', travelled_m, SINCE_TURN_M)):
        if axis[-1] == axis[0]:
            continue  # without odometry the distance is unknown
        since = axis - axis[last]
        for low, high in pairwise(edges):
            span = f'{low:g} to {high:g} {unit}' if high < math.inf else f'{low:g} {unit} and more'
            inside = after & (since >= low) & (since < high)
            for side, sign in SIDES.items():
                yield Regime(f'{span} after a turn to the {side}', inside & (sign * rate[last] > 0.0))
    axes = {'time since the start (s)': history.time_s, 'temperature (deg C)': history.temperature_c}
    axes |= {name: history.signals[:, place] for place, name in enumerate(run.signal_names)}
    for name, values in axes.items():
        yield from _of_signal(name, values, np.where(turning, rate, 0.0))


def _of_rate(rate_deg_s: Array) -> Iterator[Regime]:
    yield Regime('not turning', np.abs(rate_deg_s) <= RATE_EDGES_DEG_S[0])
    for side, sign in SIDES.items():
        yield Regime(f'turning {side}', sign * rate_deg_s > RATE_EDGES_DEG_S[0])
        for low, high in pairwise(RATE_EDGES_DEG_S):
            speed = f'at {low:g} to {high:g} deg/s' if high < math.inf else f'faster than {low:g} deg/s'
            yield Regime(f'turning {side} {speed}', (sign * rate_deg_s > low) & (sign * rate_deg_s <= high))


def _of_signal(name: str, values: Array, turning_rad_s: Array) -> Iterator[Regime]:
    known = values[np.isfinite(values)]
    if len(known) < 2 * PARTS or np.ptp(known) == 0.0:
        return
    edges = np.unique(np.quantile(known, np.linspace(0.0, 1.0, PARTS + 1)))
    for low, high in pairwise(edges.tolist()):
        inside = (values >= low) & ((values < high) | ((values == high) & (high == edges[-1])))
        yield Regime(f'{name} {low:.4g} to {high:.4g}', inside, is_motion=False)
        yield Regime(f'{name} {low:.4g} to {high:.4g}', inside * turning_rad_s, True, False)


def _errors(regimes: list[Regime], seen: Headings) -> list[tuple[Regime, float, float]]:
    """Return the regimes that tell of an error, each with its error and that in standard deviations."""
    columns = np.stack([regime.column for regime in regimes], axis=1).astype(float)
    total = heading_scores(seen, columns)
    information, score = np.einsum('bcc->c', total.information), total.score.sum(axis=0)
    known = np.flatnonzero(information > 0.0)
    values, sigmas = score[known] / information[known], score[known] / np.sqrt(information[known])
    return list(zip([regimes[place] for place in known], values.tolist(), sigmas.tolist(), strict=True))


def _in_regimes(
    errors: list[tuple[Regime, float, float]], chance: float, settings: DiagnosisSettings
) -> Iterator[Failure]:
    for regime, value, sigma in errors:
        if abs(sigma) / chance < settings.failure_sigma:
            continue
        if regime.of_scale:
            error = f'the scale needs {100.0 * value:+.3f} %'
        else:
            error = f'the gyro needs {math.degrees(value):+.3f} deg/s'
        yield Failure(f'{regime.name}: {error}', abs(sigma) / chance, regime=regime.name)


def _in_time(seen: Headings, chance: float, settings: DiagnosisSettings) -> Iterator[Failure]:
    """Yield stretches in which the rate is off; consecutive blocks are one stretch."""
    block = (seen.time_s / BLOCK_S).astype(int)
    columns = (block[:, None] == np.arange(block[-1] + 1)).astype(float)
    scores = heading_scores(seen, columns)
    # Each block by its own diagonal: a jump then shows where it happened, not as long as it lasts.
    information = np.einsum('bbb->b', scores.information)
    score = np.einsum('bb->b', scores.score)
    information = np.where(information > 0.0, information, 1.0)
    sigma = np.abs(score) / np.sqrt(information) / chance
    off = np.flatnonzero(sigma > settings.failure_sigma)
    for blocks in np.split(off, np.flatnonzero(np.diff(off) > 1) + 1):
        if len(blocks):
            worst = blocks[np.argmax(sigma[blocks])]
            from_s, to_s = BLOCK_S * blocks[0], min(BLOCK_S * (blocks[-1] + 1), float(seen.time_s[-1]))
            error = f'the gyro needs up to {math.degrees(score[worst] / information[worst]):+.3f} deg/s'
            what = f'{from_s:.0f} to {to_s:.0f} s: {error}'
            yield Failure(what, float(sigma[worst]), from_s=float(from_s), to_s=to_s)


def _length_s(regime: Regime, seen: Headings) -> float:
    return float(seen.dt_s[regime.column != 0.0].sum())
