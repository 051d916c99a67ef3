"""Fig. 9: reading of the gyro at rest while it warms up, and the fit of C1, C2 and T of eq. (8)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.paper.experiment import Claim, Mapper, assess
from gyrocal_ros.data import NS_PER_S, Array, ImuSample
from gyrocal_ros.effects import PAPER_EFFECTS
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

C1_DEG_S, C2_DEG_S, T_S = 0.6, 6.04, 500.0
"""The paper's fit of an XV-3500."""
DURATION_S, BIN_S = 2500.0, 10.0
TIMES_S = np.geomspace(50.0, 5000.0, 400)
"""Time constants that the fit tries."""


@dataclass(frozen=True, slots=True)
class Warmup:
    """`C1 (1 - exp(-t / T)) + C2`."""

    c1_deg_s: float
    c2_deg_s: float
    t_s: float

    def at(self, time_s: Array) -> Array:
        """Return the reading (n,) at times (n,)."""
        return self.c2_deg_s - self.c1_deg_s * np.expm1(-time_s / self.t_s)


@dataclass(frozen=True, slots=True, eq=False)
class AtRest:
    """The figure."""

    time_s: Array
    """(n,) middles of bins of 10 s."""
    read_deg_s: Array
    """(n,) mean reading of the first seed."""
    fits: tuple[Warmup, ...]
    """One fit per seed."""
    claims: tuple[Claim, ...]


def figure_9(each: Mapper, seeds: int) -> AtRest:
    """Estimate the parameters from 2500 s at rest; their true values are those of the paper's fit."""
    results = list(each(_record, list(range(seeds))))
    fits = tuple(fitted for _, _, fitted in results)
    time_s, read, _ = results[0]
    table = np.array([(fitted.c1_deg_s, fitted.c2_deg_s, fitted.t_s) for fitted in fits])
    means, sds = table.mean(axis=0), table.std(axis=0, ddof=min(1, seeds - 1))
    truths = (C1_DEG_S, C2_DEG_S, T_S)
    names = ('C1 (deg/s)', 'C2 (deg/s)', 'T (s)')
    claims = tuple(
        assess(
            f'{name} by least squares',
            f'{truth:g}',
            f'{mean:.{digits}f}, sd {sd:.{digits}f} over {seeds} seeds',
            abs(mean - truth) < max(3.0 * sd / math.sqrt(seeds), 0.02 * truth),
        )
        for name, truth, mean, sd, digits in zip(names, truths, means, sds, (4, 4, 0), strict=True)
    )
    return AtRest(time_s, read, fits, claims)


def fit(time_s: Array, read_deg_s: Array) -> Warmup:
    """Fit readings (n,) at rest by least squares: C1 and C2 directly, T by a scan."""
    best, least = Warmup(0.0, float(read_deg_s.mean()), float(TIMES_S[0])), math.inf
    for t_s in TIMES_S.tolist():
        columns = np.stack([-np.expm1(-time_s / t_s), np.ones(len(time_s))], axis=1)
        solution = np.linalg.lstsq(columns, read_deg_s, rcond=None)[0]
        misfit = float(np.sum((read_deg_s - columns @ solution) ** 2))
        if misfit < least:
            best, least = Warmup(float(solution[0]), float(solution[1]), t_s), misfit
    return best


def _record(seed: int) -> tuple[Array, Array, Warmup]:
    source = _source(seed)
    samples = [item for item in source.measurements() if isinstance(item, ImuSample)]
    time_s = np.array([item.t_ns - START_NS for item in samples]) / NS_PER_S
    rate = np.degrees([item.rate_rad_s[2] for item in samples])
    bins = (time_s / BIN_S).astype(int)
    counts = np.bincount(bins)
    whole = counts == counts[0]
    means = (np.bincount(bins, rate) / counts)[whole]
    middles = (np.bincount(bins, time_s) / counts)[whole]
    return middles, means, fit(middles, means)


def _source(seed: int) -> SimSource:
    """Return a gyro that warms up as the paper's; the signs are those of a correction of the reading."""
    amplitude, settled = math.radians(-C1_DEG_S), -(C1_DEG_S + C2_DEG_S)
    hidden = (HiddenEffect(PAPER_EFFECTS[8], (amplitude, T_S)),)
    scenario = _scenario(1.0)
    drawn = math.degrees(float(SimSource(scenario, seed).truth.bias_rad_s[0, 2]))
    return SimSource(_scenario(settled / drawn), seed, hidden=hidden)


def _scenario(turn_on_bias_deg_s: float) -> Scenario:
    standing = find_scenario('standing')
    errors = replace(standing.errors, scale_factor=1.0, turn_on_bias_deg_s=turn_on_bias_deg_s)
    return replace(standing, duration_s=DURATION_S, imu_hz=20, camera_until_s=0.0, errors=errors)
