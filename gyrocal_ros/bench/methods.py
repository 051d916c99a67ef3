"""Comparison with other methods of calibration: scale error, drift, time to one part in a thousand.

One recording per seed: two minutes of lanes with the camera; then it is off, the robot turns ten times to
each side and cleans for ten minutes. Every method uses the first two minutes, and dead reckoning with its
result is compared with the truth over the rest. Spins against a wall use a drive of their own by the same
robot, because ordinary drives do not contain them.
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
from gyrocal_ros.bench.camera_off import TEN_MINUTES_S, accumulated_drift, rotation_ends_s
from gyrocal_ros.bench.naive import bias_at_rest, fit_to_wheels, spins_against_wall
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.drift import dead_reckoning
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D, slam_path
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import START_NS, SimSource

OFF_S, SPINS_UNTIL_S, DURATION_S = 120.0, 225.0, 860.0
"""Times at which the camera goes off, the last spin starts, and the recording ends."""
TOLERANCE = 1e-3
"""Relative error of the scale factor at which a method has settled."""
FILTERS = (
    replace(PAPER, name='the paper as written'),
    replace(PAPER_GATED, name='the paper, updates after motion'),
    replace(OURS, name='this package'),
)


@dataclass(frozen=True, slots=True)
class MethodResult:
    """Result of one method on one recording, with the errors of its dead reckoning."""

    method: str
    scale_error: float = math.nan
    """Error of the scale factor, relative to the truth; NaN where a filter diverged."""
    scale_std: float = math.nan
    """Relative standard deviation by the method itself; NaN where it has none."""
    settled_s: float = math.nan
    """Time since the first motion from which the scale factor is within 0.1 % of the truth; NaN where it is
    not, or where the method gives no value for each step."""
    spins_rad: tuple[float, ...] = ()
    """Heading errors that accumulate in ten rotations, to one side and to the other."""
    cleaning_rad: float = math.nan
    """Heading error that accumulates in ten minutes of cleaning after the rotations."""


def comparison(seeds: int) -> Iterator[dict[str, Any]]:
    """Yield one row per method."""
    every = list(in_parallel(compare_on, range(seeds)))
    bounds = np.array([found[-1].scale_std for found in every])
    for found in zip(*every, strict=True):
        yield row(list(found), bounds)


def row(found: list[MethodResult], bounds: Array) -> dict[str, Any]:
    """Return the figures of one method over the seeds.

    Args:
        found: its results, one per seed.
        bounds: (seeds,) standard deviations of the bound.
    """
    error, std = (np.array([getattr(item, name) for item in found]) for name in ('scale_error', 'scale_std'))
    settled = np.array([item.settled_s for item in found])
    spins = np.degrees([angle for item in found for angle in item.spins_rad])
    return {
        'way': found[0].method,
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
    """Return the drive of every recording."""
    return replace(
        find_scenario('lanes'),
        stages=(('lanes', OFF_S), ('spins', SPINS_UNTIL_S), ('cleaning', 0.0)),
        duration_s=DURATION_S,
        camera_until_s=OFF_S,
    )


def compare_on(seed: int) -> tuple[MethodResult, ...]:
    """Run every method on the recording of one seed, the bound last."""
    source = SimSource(scenario(), seed)
    every = list(source.measurements())
    recording = InMemorySource(source.name, source.rig, source.span, every)
    runs = {variant.name: _run(recording, variant) for variant in FILTERS}
    ours, truth = runs[FILTERS[-1].name], source.truth.scale_factor
    assert ours is not None

    early = [item for item in every if item.t_ns < START_NS + OFF_S * NS_PER_S]
    standing_s = source.scenario.standing_s
    zero = bias_at_rest(early, standing_s)
    wheels, batch = fit_to_wheels(early), solve(early, source.rig, Config())
    wall_scale, wall_s = spins_against_wall(source.scenario, seed)
    wall_settled_s = wall_s if abs(wall_scale / truth - 1.0) < TOLERANCE else math.nan
    wheels_s = settled_after_s(wheels.time_s - standing_s, wheels.scale / truth - 1.0, TOLERANCE)
    wheels_scale, wheels_bias = float(wheels.scale[-1]), float(wheels.bias_rad_s[-1])

    def blind(result: MethodResult, scale: float, bias_rad_s: float) -> MethodResult:
        path = dead_reckoning(ours, np.array([scale - 1.0]), bias_rad_s)
        return _with_drift(source, ours, path, replace(result, scale_error=scale / truth - 1.0))

    return (
        blind(MethodResult('nominal scale'), 1.0, zero),
        blind(MethodResult('wheel headings', settled_s=wheels_s), wheels_scale, wheels_bias),
        blind(
            MethodResult('spins against a wall', settled_s=wall_settled_s),
            wall_scale,
            zero,
        ),
        *(_filter_result(source, name, run) for name, run in runs.items()),
        blind(
            MethodResult('batch of everything', scale_std=batch.scale_factor_std / truth),
            batch.scale_factor,
            batch.bias_rad_s,
        ),
    )


def _run(recording: InMemorySource, variant: Variant) -> Run | None:
    try:
        return calibrate(recording, variant.config(Config()), variant.model())
    except FilterDivergedError:
        return None


def _filter_result(source: SimSource, name: str, run: Run | None) -> MethodResult:
    """Return the estimate of a filter when the camera goes off; its prediction is the dead reckoning."""
    if run is None:
        return MethodResult(name)
    truth, history = source.truth.scale_factor, run.history
    with_camera = history.time_s < OFF_S
    errors = (1.0 + history.coefficients[with_camera, 0]) / truth - 1.0
    std = float(history.std[with_camera, COEFFICIENTS_START][-1]) / truth
    settled_s = settled_after_s(history.time_s[with_camera] - source.scenario.standing_s, errors, TOLERANCE)
    return _with_drift(source, run, slam_path(run), MethodResult(name, float(errors[-1]), std, settled_s))


def _with_drift(source: SimSource, run: Run, path: Trajectory2D, result: MethodResult) -> MethodResult:
    ends_s = rotation_ends_s(source)
    moments_s = np.append(ends_s, ends_s[-1] + TEN_MINUTES_S)
    *spins, cleaning = accumulated_drift(source, run, path, moments_s).heading_rad.tolist()
    return replace(result, spins_rad=tuple(spins), cleaning_rad=cleaning)


def _rms(values: Array) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _max(values: Array) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.abs(good).max()) if len(good) else None
