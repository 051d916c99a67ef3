"""Fig. 10: convergence of the scale factor while the robot cleans."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.accuracy import OURS, PAPER, PAPER_GATED
from gyrocal_ros.bench.bench_run import Variant, settled_after_s
from gyrocal_ros.bench.paper.experiment import NOMINAL_VOLT, TRUE_VOLT, Claim, Mapper, assess
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

FEATURES, DURATION_S, SHOWN_S = 5, 60.0, 20.0
TOLERANCE = 1e-3
"""Relative error below which the scale factor has converged, if it stays there."""
VARIANTS = (OURS, PAPER, PAPER_GATED)


@dataclass(frozen=True, slots=True, eq=False)
class ScaleTrace:
    """Scale factor over time in one run."""

    time_s: Array
    """(n,) time since the first motion."""
    volt: Array
    """(n,) scale factor, deg/s/V."""
    std_volt: Array
    settled_s: float
    """Time from which the scale factor is within 0.1 % of the truth; NaN if it never is."""


@dataclass(frozen=True, slots=True, eq=False)
class VariantResult:
    """Results of one variant of the filter."""

    name: str
    first: ScaleTrace | None
    """Trace of the first seed; None where the filter diverged."""
    settled_s: Array
    """(seeds,) times of convergence; NaN without convergence."""
    final_volt: Array
    """(seeds,) scale factors after a minute; NaN where the filter diverged."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceFigure:
    """The figure."""

    varieties: tuple[VariantResult, ...]
    claims: tuple[Claim, ...]


def figure_10(each: Mapper, seeds: int) -> ConvergenceFigure:
    """Compare our filter, the paper's as written, and the paper's with updates only after some motion."""
    tasks = [(variant, seed) for variant in VARIANTS for seed in range(seeds)]
    every = list(each(_trace, tasks))
    results = tuple(
        _variant_result(variant.name, every[i * seeds : (i + 1) * seeds])
        for i, variant in enumerate(VARIANTS)
    )
    return ConvergenceFigure(results, tuple(map(_claim, results)))


def _variant_result(name: str, traces: list[ScaleTrace | None]) -> VariantResult:
    settled = [math.nan if trace is None else trace.settled_s for trace in traces]
    final = [math.nan if trace is None else float(trace.volt[-1]) for trace in traces]
    return VariantResult(name, traces[0], np.array(settled), np.array(final))


def _claim(result: VariantResult) -> Claim:
    seeds, reached = len(result.settled_s), result.settled_s[np.isfinite(result.settled_s)]
    soon = int(np.sum(reached <= SHOWN_S))
    times = f', median {np.median(reached):.1f} s, last {reached.max():.1f} s' if len(reached) else ''
    final = result.final_volt[np.isfinite(result.final_volt)]
    rms = math.sqrt(float(np.mean((final - TRUE_VOLT) ** 2))) if len(final) else math.nan
    return assess(
        f'reaches {TRUE_VOLT} deg/s/V within 20 s of motion: {result.name}',
        'one run, by eye',
        f'to {100.0 * TOLERANCE:g} % and for good: {soon} of {seeds} runs{times}; rms error after '
        f'{DURATION_S:.0f} s {rms:.4f} deg/s/V',
        soon >= 0.95 * seeds,
    )


def _trace(task: tuple[Variant, int]) -> ScaleTrace | None:
    variant, seed = task
    scenario = replace(find_scenario('lanes'), duration_s=DURATION_S, features=FEATURES)
    source = SimSource(scenario, seed)
    try:
        run = calibrate(source, variant.config(Config()), variant.model())
    except FilterDivergedError:
        return None
    scale = 1.0 + run.history.coefficients[:, 0]
    time_s = run.history.time_s - scenario.standing_s
    settled_s = settled_after_s(time_s, scale / source.truth.scale_factor - 1.0, TOLERANCE)
    std = run.history.std[:, COEFFICIENTS_START]
    return ScaleTrace(time_s, NOMINAL_VOLT * scale, NOMINAL_VOLT * std, settled_s)
