"""Fig. 10: how the scale factor converges while the robot cleans."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.bench.accuracy import OURS, PAPER, PAPER_GATED
from gyrocal_ros.bench.bench_run import Variant, settled_after_s
from gyrocal_ros.bench.paper.experiment import NOMINAL_VOLT, TRUE_VOLT, Claim, Mapper, assessed
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

FEATURES, DURATION_S, SHOWN_S = 5, 60.0, 20.0
WITHIN = 1e-3
"""Of the true scale factor: then it counts as reached, if it stays."""
VARIANTS = (OURS, PAPER, PAPER_GATED)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The scale factor of one run."""

    time_s: Array
    """(n,) since the first motion."""
    volt: Array
    """(n,) deg/s/V"""
    std_volt: Array
    settled_s: float
    """From when on it is within 0.1 % of the truth; NaN if it is not."""


@dataclass(frozen=True, slots=True, eq=False)
class Variety:
    """What one variant of the filter does."""

    name: str
    first: Course | None
    """With the first seed; None where it diverged."""
    settled_s: Array
    """(seeds,) NaN where the truth was not reached."""
    final_volt: Array
    """(seeds,) after a minute; NaN where it diverged."""


@dataclass(frozen=True, slots=True, eq=False)
class ConvergenceFigure:
    """The figure."""

    varieties: tuple[Variety, ...]
    claims: tuple[Claim, ...]


def figure_10(each: Mapper, seeds: int) -> ConvergenceFigure:
    """Our filter, the paper's as it is written, and the paper's with updates only after some motion."""
    tasks = [(variant, seed) for variant in VARIANTS for seed in range(seeds)]
    every = list(each(_course, tasks))
    varieties = tuple(
        _variety(variant.name, every[i * seeds : (i + 1) * seeds]) for i, variant in enumerate(VARIANTS)
    )
    return ConvergenceFigure(varieties, tuple(map(_claim, varieties)))


def _variety(name: str, courses: list[Course | None]) -> Variety:
    settled = [math.nan if course is None else course.settled_s for course in courses]
    final = [math.nan if course is None else float(course.volt[-1]) for course in courses]
    return Variety(name, courses[0], np.array(settled), np.array(final))


def _claim(variety: Variety) -> Claim:
    seeds, reached = len(variety.settled_s), variety.settled_s[np.isfinite(variety.settled_s)]
    soon = int(np.sum(reached <= SHOWN_S))
    times = f', median {np.median(reached):.1f} s, last {reached.max():.1f} s' if len(reached) else ''
    final = variety.final_volt[np.isfinite(variety.final_volt)]
    rms = math.sqrt(float(np.mean((final - TRUE_VOLT) ** 2))) if len(final) else math.nan
    return assessed(
        f'reaches {TRUE_VOLT} deg/s/V within 20 s of motion: {variety.name}',
        'one run, to the eye',
        f'to {100.0 * WITHIN:g} % and for good: {soon} of {seeds} runs{times}; rms error after '
        f'{DURATION_S:.0f} s {rms:.4f} deg/s/V',
        soon >= 0.95 * seeds,
    )


def _course(task: tuple[Variant, int]) -> Course | None:
    variant, seed = task
    scenario = replace(find_scenario('lanes'), duration_s=DURATION_S, features=FEATURES)
    source = SimSource(scenario, seed)
    try:
        run = calibrate(source, variant.config(Config()), variant.model())
    except FilterDivergedError:
        return None
    scale = 1.0 + run.history.coefficients[:, 0]
    time_s = run.history.time_s - scenario.standing_s
    settled_s = settled_after_s(time_s, scale / source.truth.scale_factor - 1.0, WITHIN)
    std = run.history.std[:, COEFFICIENTS_START]
    return Course(time_s, NOMINAL_VOLT * scale, NOMINAL_VOLT * std, settled_s)
