"""Honesty and diagnosis with heading references in place of the camera, on simulated robots.

The seed draws the scale factor of the robot and the reference: its white noise, random walk, outliers, time
offset, gaps and jumps (`sim.references`). Every recording has a robot of its own: the same robot before five
references would make the same error of the bias five times, which is known from the rest at its start.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.bench.reference_bound import Bound, reference_bound
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, ImuSample
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.model.sensor import placed
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.hidden import DRAWN, DrawnEffect, draw_scale_factor, draw_values, hide
from gyrocal_ros.sim.references import KINDS, ReferenceSource
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.sensors import stream, with_bias_walk
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S = 180.0
EFFECTS_CASE = 'effects'
SPAN_S = 60.0
"""Time over which the drift by an effect and that of the reference are compared."""
LARGE = 3.0
"""An effect is large if it makes the heading drift by as many standard deviations of the reference."""
BOUNDED_S = 1e5
"""Correlation time of a bias that walks at random, long beside all recordings."""
DRAWS = 8
"""Number of effects that are drawn for a recording until one is large."""
INSIDE_SIGMA = 1.96
"""Half of the interval that contains 95 % of normal errors."""
CLAIMS = ('effect_found', 'noise', 'unexplained')
"""Verdicts that claim that something is missing."""


@dataclass(frozen=True, slots=True)
class ReferenceResult:
    """Result of one recording; NaN where the calibration failed."""

    kind: str
    hidden: str = ''
    """Name of the hidden effect; empty for none."""
    is_large: bool = False
    """True if the hidden effect is large beside the drift of the reference."""
    failure: str = ''
    """Reason for which there is no calibration; empty where there is one."""
    scale_z: float = math.nan
    bias_z: float = math.nan
    """Errors of scale factor and bias in their standard deviations."""
    scale_std: float = math.nan
    scale_by_bound: float = math.nan
    bias_by_bound: float = math.nan
    """Standard deviations over their Cramer-Rao bounds."""
    converged: bool = False
    verdict: str = ''
    named: tuple[str, ...] = ()
    """Effects that the diagnosis reports as missing."""
    twins: tuple[str, ...] = ()
    """Effects that this recording cannot distinguish from the first of them."""


def cases() -> list[str]:
    """Return the cases: nothing hidden behind each kind of reference, and hidden effects."""
    return [*KINDS, EFFECTS_CASE]


def references(seeds: int, only: Collection[str] = (), *, varied: bool = False) -> Iterator[dict[str, Any]]:
    """Yield one row per case as they become ready, and one for all recordings that hide nothing.

    Args:
        seeds: number of recordings of each case; hidden effects have each kind of reference in turn.
        only: labels of cases; empty for all.
        varied: True to draw robot, room and drive by the seed as well.
    """
    chosen = [case for case in cases() if not only or case in only]
    tasks = [(case, _robot(case, number), varied) for case in chosen for number in range(seeds)]
    clean: list[ReferenceResult] = []
    for (case, *_), group in groupby(
        zip(tasks, in_parallel(_run_task, tasks), strict=True), key=lambda pair: (pair[0][0], None)
    ):
        results = [result for _, result in group]
        if case == EFFECTS_CASE:
            if clean:
                yield clean_row('all', clean)
            yield effects_row(results)
        else:
            clean += results
            yield clean_row(case, results)
    if clean and EFFECTS_CASE not in chosen:
        yield clean_row('all', clean)


def clean_row(label: str, results: Sequence[ReferenceResult]) -> dict[str, Any]:
    """Return the figures of recordings that hide nothing."""
    good = [result for result in results if not result.failure]

    def column(name: str) -> Array:
        return np.array([getattr(result, name) for result in good])

    claims = Counter(_answer(result) for result in good if result.verdict in CLAIMS)
    return {
        'reference': label,
        'bags': len(results),
        'failed': len(results) - len(good),
        'scale_z_rms': _rms(column('scale_z')),
        'bias_z_rms': _rms(column('bias_z')),
        'scale_inside': _share(np.abs(column('scale_z')) < INSIDE_SIGMA),
        'bias_inside': _share(np.abs(column('bias_z')) < INSIDE_SIGMA),
        'scale_by_bound': _median(column('scale_by_bound')),
        'scale_by_bound_max': _max(column('scale_by_bound')),
        'bias_by_bound': _median(column('bias_by_bound')),
        'bias_by_bound_max': _max(column('bias_by_bound')),
        'scale_std_percent': _median(100.0 * column('scale_std')),
        'converged': _share(column('converged').astype(bool)),
        'false_claims': _share(np.array([result.verdict in CLAIMS for result in good])),
        'claimed': _counted(claims),
    }


def effects_row(results: Sequence[ReferenceResult]) -> dict[str, Any]:
    """Return the figures of recordings that hide an effect; shares are those of the large ones."""
    large = [result for result in results if result.is_large]
    is_first = np.array([result.named[:1] == (result.hidden,) for result in large], bool)
    is_twin = np.array([result.hidden in result.twins for result in large], bool)
    misses = Counter(
        f'{result.hidden} as {_answer(result)}'
        for result, found in zip(large, is_first | is_twin, strict=True)
        if not found
    )
    return {
        'reference': EFFECTS_CASE,
        'bags': len(results),
        'failed': sum(bool(result.failure) for result in results),
        'large': len(large),
        'named_first': _share(is_first),
        'or_twin': _share(is_first | is_twin),
        'missed': _counted(misses),
    }


def run_reference(
    case: str, seed: int, duration_s: float = DURATION_S, *, varied: bool = False
) -> ReferenceResult:
    """Simulate a recording with a reference, calibrate and diagnose it, and compare with the truth.

    Args:
        case: kind of reference, or `EFFECTS_CASE`.
        seed: draws the scale factor, the reference and the hidden effect.
        duration_s: length of the recording.
        varied: True to draw robot, room and drive by the seed as well.
    """
    scenario = varied_scenario(seed) if varied else find_scenario('cleaning')
    scenario = replace(scenario, duration_s=duration_s)
    errors = replace(scenario.errors, scale_factor=draw_scale_factor(seed))
    if case != EFFECTS_CASE and not varied:
        # These judge the filter, not its settings, so the bias walks as they say; elsewhere it is bounded.
        errors = with_bias_walk(errors, Config().gyro.bias_walk_deg_s, BOUNDED_S)
    robot = SimSource(replace(scenario, errors=errors), seed)
    if case != EFFECTS_CASE:
        return _calibrated(ReferenceSource(robot, case), ReferenceResult(case))
    kind = list(KINDS)[seed % len(KINDS)]
    walk_rad = ReferenceSource(robot, kind).reference.walk_rad
    rng = stream(seed, 'effect behind a reference')
    names = [name for name in DRAWN if placed((find_effect(name),), 'gyro')]
    for _ in range(DRAWS):
        drawn = draw_values(str(rng.choice(names)), rng, duration_s)
        hiding = _hiding(robot, drawn)
        is_large = drift_rad(hiding, robot) > LARGE * walk_rad * math.sqrt(SPAN_S)
        if is_large:
            break
    return _calibrated(ReferenceSource(hiding, kind), ReferenceResult(kind, drawn.name, is_large))


def drift_rad(hiding: SimSource, clean: SimSource) -> float:
    """Return the rms heading error by hidden effects over `SPAN_S`, beside the best scale factor and bias."""
    samples = [item for item in clean.board_measurements() if isinstance(item, ImuSample)]
    changed = [item.rate_rad_s[2] for item in hiding.board_measurements() if isinstance(item, ImuSample)]
    rate = np.array([item.rate_rad_s[2] for item in samples])
    dt_s, span = 1.0 / clean.scenario.imu_hz, round(SPAN_S * clean.scenario.imu_hz)
    error, turned = (dt_s * np.cumsum(column) for column in (np.array(changed) - rate, rate))
    columns = np.stack([turned, np.arange(len(rate)) * dt_s, np.ones(len(rate))], axis=1)
    left = error - columns @ np.linalg.lstsq(columns, error, rcond=None)[0]
    span = min(span, len(left) // 2)
    return float(np.sqrt(np.mean((left[span:] - left[:-span]) ** 2)))


def _hiding(robot: SimSource, drawn: DrawnEffect) -> SimSource:
    """Return the same robot with a hidden effect."""
    scenario: Scenario = robot.scenario
    return SimSource(scenario, robot.seed, hidden=hide([drawn], find_effect))


def _calibrated(simulated: ReferenceSource, result: ReferenceResult) -> ReferenceResult:
    """Return the result with the calibration and the diagnosis of a recording."""
    model = default_model()
    source, config = preload(simulated, Config(), model)
    run, recorded = partial(calibrate, source, config), summarise_recording(source)
    try:
        searched = find_missing(model, recorded, lambda present, tried: run(present, candidates=tried))
    except GyrocalError as error:
        return replace(result, failure=error.what)
    calibration, found = conclude(searched.first.run), diagnose(searched, recorded)
    return _compared(result, calibration, found, simulated, reference_bound(simulated, config))


def _compared(
    result: ReferenceResult,
    calibration: Calibration,
    found: Diagnosis,
    simulated: ReferenceSource,
    bound: Bound,
) -> ReferenceResult:
    truth = simulated.truth
    bias_std, scale_std = calibration.stds[:2].tolist()
    return replace(
        result,
        scale_z=(calibration.scale_factor - truth.scale_factor) / scale_std,
        bias_z=float(calibration.values[0] - truth.bias_rad_s[-1, 2]) / bias_std,
        scale_std=scale_std,
        scale_by_bound=scale_std / bound.scale_std,
        bias_by_bound=bias_std / bound.bias_std_rad_s,
        converged=calibration.converged,
        verdict=found.verdict,
        named=tuple(item.effect.name for item in found.missing),
        twins=tuple(found.missing[0].confused_with) if found.missing else (),
    )


def _robot(case: str, number: int) -> int:
    """Return the seed of a recording of a case: no two kinds of reference share a robot."""
    return number if case == EFFECTS_CASE else number * len(KINDS) + list(KINDS).index(case)


def _run_task(task: tuple[str, int, bool]) -> ReferenceResult:
    case, seed, varied = task
    return run_reference(case, seed, varied=varied)


def _answer(result: ReferenceResult) -> str:
    return result.failure or ' + '.join(result.named) or result.verdict


def _counted(answers: Counter[str]) -> str:
    return ', '.join(f'{answer} {count}' for answer, count in answers.most_common())


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _median(values: Array) -> float | None:
    return float(np.median(values)) if len(values) else None


def _max(values: Array) -> float | None:
    return float(values.max()) if len(values) else None


def _share(values: NDArray[np.bool_]) -> float | None:
    return float(np.mean(values)) if len(values) else None
