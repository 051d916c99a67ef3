"""What a user would do instead, in the same run: scale error, drift, time to one part in a thousand.

One recording a seed: two minutes of lanes with the camera; then it is off, the robot turns ten times to
each side and cleans for ten minutes. Every way of calibrating gets the first two minutes, and dead
reckoning with what it found is held against the truth over the rest. Spinning against a wall gets a
drive of its own by the same robot, for nobody spins like that by the way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import OURS, PAPER, PAPER_GATED, in_parallel
from gyrocal_ros.bench.batch import solve
from gyrocal_ros.bench.bench_run import Variant, settled_after_s
from gyrocal_ros.bench.camera_off import TEN_MINUTES_S, gathered, rotation_ends_s
from gyrocal_ros.bench.naive import against_a_wall, by_wheels, zero_at_rest
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.drift import Trajectory2D, dead_reckoning, slam_path
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.state import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

OFF_S, SPINS_UNTIL_S, DURATION_S = 120.0, 225.0, 860.0
"""When the camera goes off, until when spins are begun, and the end of the recording."""
WITHIN = 1e-3
FILTERS = (
    replace(PAPER, name='the paper as written'),
    replace(PAPER_GATED, name='the paper, updates after motion'),
    replace(OURS, name='this package'),
)


@dataclass(frozen=True, slots=True)
class Known:
    """What one way of calibrating finds on one recording, and what comes of it."""

    way: str
    scale_error: float = math.nan
    """Relative to the truth; NaN where a filter diverged."""
    scale_std: float = math.nan
    """What it says of itself, relative; NaN where it says nothing."""
    settled_s: float = math.nan
    """From when on the scale factor is within 0.1 % of the truth, since the first motion; NaN where it
    is not, or where it is not told step by step."""
    spins_rad: tuple[float, ...] = ()
    """Heading errors gathered in ten rotations, to one side and to the other."""
    cleaning_rad: float = math.nan
    """In ten minutes of cleaning after those."""


def comparison(seeds: int) -> Iterator[dict[str, Any]]:
    """Yield a row for each way of calibrating."""
    every = list(in_parallel(compare_on, range(seeds)))
    bounds = np.array([found[-1].scale_std for found in every])
    for found in zip(*every, strict=True):
        yield row(list(found), bounds)


def row(found: list[Known], bounds: Array) -> dict[str, Any]:
    """The figures of one way over the seeds, beside the standard deviations (seeds,) of the bound."""
    error, std = (np.array([getattr(item, name) for item in found]) for name in ('scale_error', 'scale_std'))
    settled = np.array([item.settled_s for item in found])
    spins = np.degrees([angle for item in found for angle in item.spins_rad])
    return {
        'way': found[0].way,
        'seeds': len(found),
        'diverged': int(np.isnan(error).sum()),
        'scale_rms_percent': _rms(100.0 * error),
        'scale_max_percent': _max(100.0 * error),
        'error_by_std': _rms(error / std),
        'std_by_bound': _rms(std / bounds),
        'spins_mean_abs_deg': float(np.abs(spins).mean()) if len(spins) else None,
        'spins_max_deg': _max(spins),
        'minutes_rms_deg': _rms(np.degrees([item.cleaning_rad for item in found])),
        'settled_seeds': int(np.isfinite(settled).sum()),
        'settled_median_s': float(np.nanmedian(settled)) if np.isfinite(settled).any() else None,
        'settled_max_s': _max(settled),
    }


def scenario() -> Scenario:
    """The drive of every recording."""
    return replace(
        find_scenario('lanes'),
        stages=(('lanes', OFF_S), ('spins', SPINS_UNTIL_S), ('cleaning', 0.0)),
        duration_s=DURATION_S,
        camera_until_s=OFF_S,
    )


def compare_on(seed: int) -> tuple[Known, ...]:
    """Every way on the recording of one seed, the bound last."""
    source = SimSource(scenario(), seed)
    every = list(source.measurements())
    held = InMemorySource(source.name, source.rig, source.span, every)
    runs = {variant.name: _run(held, variant) for variant in FILTERS}
    ours, truth = runs[FILTERS[-1].name], source.truth.scale_factor
    assert ours is not None

    early = [item for item in every if item.t_ns < START_NS + OFF_S * NS_PER_S]
    standing_s = source.scenario.standing_s
    zero = zero_at_rest(early, standing_s)
    wheels, batch = by_wheels(early), solve(early, source.rig, Config())
    wall_scale, wall_s = against_a_wall(source.scenario, seed)
    wall_good = abs(wall_scale / truth - 1.0) < WITHIN
    wheels_s = settled_after_s(wheels.time_s - standing_s, wheels.scale / truth - 1.0, WITHIN)
    wheels_scale, wheels_bias = float(wheels.scale[-1]), float(wheels.bias_rad_s[-1])

    def blind(known: Known, scale: float, bias_rad_s: float) -> Known:
        path = dead_reckoning(ours, np.array([scale - 1.0]), bias_rad_s)
        return _drifting(source, ours, path, replace(known, scale_error=scale / truth - 1.0))

    return (
        blind(Known('nominal scale'), 1.0, zero),
        blind(Known('wheel headings', settled_s=wheels_s), wheels_scale, wheels_bias),
        blind(Known('spins against a wall', settled_s=wall_s if wall_good else math.nan), wall_scale, zero),
        *(_filtered(source, name, run) for name, run in runs.items()),
        blind(
            Known('batch of everything', scale_std=batch.scale_factor_std / truth),
            batch.scale_factor,
            batch.bias_rad_s,
        ),
    )


def _run(held: InMemorySource, variant: Variant) -> Run | None:
    try:
        return calibrate(held, variant.config(Config()), variant.model())
    except FilterDivergedError:
        return None


def _filtered(source: SimSource, name: str, run: Run | None) -> Known:
    """What a filter knows when the camera goes off; its own prediction is the dead reckoning."""
    if run is None:
        return Known(name)
    truth, history = source.truth.scale_factor, run.history
    seeing = history.time_s < OFF_S
    errors = (1.0 + history.coefficients[seeing, 0]) / truth - 1.0
    std = float(history.std[seeing, COEFFICIENTS_START][-1]) / truth
    settled_s = settled_after_s(history.time_s[seeing] - source.scenario.standing_s, errors, WITHIN)
    return _drifting(source, run, slam_path(run), Known(name, float(errors[-1]), std, settled_s))


def _drifting(source: SimSource, run: Run, path: Trajectory2D, known: Known) -> Known:
    ends_s = rotation_ends_s(source)
    moments_s = np.append(ends_s, ends_s[-1] + TEN_MINUTES_S)
    *spins, cleaning = gathered(source, run, path, moments_s).heading_rad.tolist()
    return replace(known, spins_rad=tuple(spins), cleaning_rad=cleaning)


def _rms(values: Array) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _max(values: Array) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.abs(good).max()) if len(good) else None
