"""Blind trials: effects are hidden in recordings, and the diagnosis is compared with the truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import first_seeds, in_parallel
from gyrocal_ros.bench.blind_cases import Case, cases
from gyrocal_ros.bench.eyes import StoredImages, model_of
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.drift import blind_drift
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.runs import remembered
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.diagnose.unknown_law import name_unknown
from gyrocal_ros.effects import find_effect
from gyrocal_ros.effects.traits import scanned_coefficient
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import (
    draw_hidden,
    draw_scale_factor,
    hide,
)
from gyrocal_ros.sim.image_scenes import find_scene
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource
from gyrocal_ros.statistics import vuong_sigma

COSTLY_DRIFT_DEG = 0.5
COSTLY_SCALE = 2e-4
"""Thresholds of blind drift and relative scale error; an effect that exceeds neither may be missed."""
KNOWN_PART = 0.2
"""Prior standard deviation of a known time constant, as a part of it; a wide one may mislead the filter."""
SHOWN = 8.0
"""Predictive log-likelihood that an effect gains where a recording shows it: that of 4 sigma."""
MOMENT_S = 5.0
"""Maximum error of the reported time of a jump."""


@dataclass(frozen=True, slots=True)
class BlindResult:
    """Result of one recording."""

    case: Case
    seed: int
    hidden: tuple[tuple[str, tuple[float, ...]], ...]
    """Names and true values."""
    is_costly: bool
    """True if the omission of any one of them from the model exceeds a threshold."""
    shown: tuple[float, ...]
    """Predictive log-likelihood that each one gains, all at their true values; see `SHOWN`."""
    drift_known_deg: float
    """Blind drift with the true sensor model."""
    verdict: str = 'diverged'
    named: tuple[str, ...] = ()
    """Effects that the diagnosis reports as missing, in decreasing order of explanation."""
    excuses: tuple[str, ...] = ()
    """Effects that this recording cannot distinguish from the named ones."""
    left: str = ''
    """Description of the structure that no effect explains."""
    is_right: bool = False
    is_excused: bool = False
    """True if not right, but as right as this recording allows; see `is_excused`."""
    errors_sigma: tuple[float, ...] = ()
    """Errors of the coefficients of effects that were found, in standard deviations."""
    drift_before_deg: float = math.nan
    drift_after_deg: float = math.nan


def blind(
    seeds: int,
    only: Sequence[str] = (),
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
    scenes: Sequence[str] = (),
    varied: bool = False,
) -> Iterator[dict[str, Any]]:
    """Yield one row per case as they become ready, and one for all cases together.

    Args:
        seeds: number of recordings of each case.
        only: labels of cases; empty for all.
        settings: thresholds of the diagnosis.
        scenes: scenes of images, in turn for the recordings of a case; empty for tracked features.
        varied: True to draw robot, room, drive and sensors by the seed as well.
    """
    scene_of = [scenes[k % len(scenes)] if scenes else None for k in range(seeds)]
    tasks = [
        (case, first + k, settings, scene_of[k], varied)
        for case, first in first_seeds(cases(), seeds).items()
        if not only or case.label in only
        for k in range(seeds)
    ]
    every = []
    for _, group in groupby(in_parallel(_run_task, tasks), key=lambda result: result.case):
        results = list(group)
        every += results
        yield row(results[0].case.label, results)
    yield row('all', every)


def row(label: str, results: Sequence[BlindResult]) -> dict[str, Any]:
    """Return the figures of some recordings."""
    costly = [result for result in results if result.is_costly] if results[0].case.names else list(results)
    errors = np.abs([error for result in results for error in result.errors_sigma])
    answers = Counter(_answer(result) for result in results)
    return {
        'hidden': label,
        'bags': len(results),
        'costly': len(costly),
        'right': _share([result.is_right for result in costly]),
        'or_twin': _share([result.is_right or result.is_excused for result in costly]),
        'wrong': _share([_is_confident(result) and not result.is_right for result in results]),
        'in_3_sigma': _share((errors < 3.0).tolist()),
        'max_sigma': float(errors.max()) if len(errors) else None,
        'before_deg': _mean([result.drift_before_deg for result in results]),
        'after_deg': _mean([result.drift_after_deg for result in results]),
        'known_deg': _mean([result.drift_known_deg for result in results]),
        'named': ', '.join(f'{name} {count}' for name, count in answers.most_common()),
    }


def run_blind(
    case: Case,
    seed: int,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
    scene: str | None = None,
    varied: bool = False,
) -> BlindResult:
    """Hide effects in a simulated recording, diagnose it and compare with the truth.

    Args:
        case: the hidden effects.
        seed: seed of the recording.
        settings: thresholds of the diagnosis.
        scene: scene of the images; None for tracked features.
        varied: True to draw robot, room, drive and sensors by the seed as well.
    """
    scenario = varied_scenario(seed) if varied else find_scenario('cleaning')
    config = _with_noise(Config(), case.noise)
    if scene is not None:
        scenario = find_scene(scene).applied_to(scenario)
    drawn = draw_hidden(seed, scenario.duration_s, case.names)
    scale_factor = draw_scale_factor(seed)
    scenario = replace(scenario, errors=replace(scenario.errors, scale_factor=scale_factor))
    simulated = SimSource(scenario, seed, images=scene is not None, hidden=hide(drawn, find_effect))
    present = model_of(scenario)
    source, config = preload(StoredImages(simulated), config, present)
    run, hidden = partial(calibrate, source, config), simulated.hidden
    recorded = summarise_recording(source)

    @remembered
    def calibrated(model: SensorModel, tried: tuple[Effect, ...]) -> Run:
        return run(model, candidates=tried)

    try:
        searched = find_missing(present, recorded, calibrated, settings=settings)
        searched = name_unknown(searched, recorded, calibrated)
    except FilterDivergedError:
        searched = None

    def finished(model: SensorModel) -> Run:
        has_run = searched is not None and searched.first.model == model
        return searched.first.run if has_run else run(model)  # type: ignore[union-attr]

    rest = [hidden[:i] + hidden[i + 1 :] for i in range(len(hidden))]
    known, *without = (_with_truth(finished, present, items) for items in (hidden, *rest))
    least = _model_error(known, scale_factor)
    result = BlindResult(
        case=case,
        seed=seed,
        hidden=tuple((item.effect.name, item.values) for item in hidden),
        is_costly=all(_model_error(item, scale_factor).is_much_worse_than(least) for item in without),
        shown=tuple(float(_gain(item, known).sum()) for item in without),
        drift_known_deg=least.drift_deg,
    )
    if searched is None:
        return result
    return _with_diagnosis(result, hidden, searched, diagnose(searched, recorded), known)


@dataclass(frozen=True, slots=True)
class _ModelError:
    """Errors of a sensor model on a recording whose truth is known."""

    drift_deg: float
    scale_error: float

    def is_much_worse_than(self, other: _ModelError) -> bool:
        """Return True if the model is worse by more than the thresholds; NaN (divergence) is.

        Where the recording is too short for a blind minute, only the scale error counts.
        """
        is_short = math.isnan(other.drift_deg) and math.isfinite(other.scale_error)
        cost_deg = 0.0 if is_short else math.sqrt(max(self.drift_deg**2 - other.drift_deg**2, 0.0))
        return not (cost_deg <= COSTLY_DRIFT_DEG and self.scale_error <= COSTLY_SCALE)


def _with_truth(
    run: Callable[[SensorModel], Run], model: SensorModel, hidden: Sequence[HiddenEffect]
) -> Run | None:
    """Run with these effects, their prior means at the true values; None where the filter diverges."""
    for item in hidden:
        known = with_means(item.effect, item.values)
        place = scanned_coefficient(known)
        if place is not None:
            parts = [*known.coefficients]
            std = min(parts[place].prior_std, KNOWN_PART * abs(parts[place].prior_mean))
            parts[place] = replace(parts[place], prior_std=std)
            known = replace(known, coefficients=tuple(parts))  # type: ignore[type-var]
        model = with_effect(model, known)
    with suppress(FilterDivergedError):
        return run(model)
    return None


def _model_error(run: Run | None, scale_factor: float) -> _ModelError:
    """Return the errors of a run; NaN without one."""
    if run is None:
        return _ModelError(math.nan, math.nan)
    scale_error = abs((1.0 + float(run.state.coefficients[0])) / scale_factor - 1.0)
    return _ModelError(_drift_deg(run), scale_error)


def _gain(before: Run | None, after: Run | None) -> Array:
    """Return the predictive log-likelihood gained in each block of time; infinite where one diverged."""
    if before is None or after is None:
        return np.array([math.inf if before is None else -math.inf])
    return predictive_gain(before, after)


def _tells_apart(searched: Search, known: Run | None) -> bool:
    """Return True if the recording is predicted clearly better with the truth than with what was found."""
    sigma = 0.0 if known is None else vuong_sigma(_gain(searched.last.run, known))
    return sigma > searched.last.settings.indistinguishable_sigma


def _with_diagnosis(
    result: BlindResult,
    hidden: Sequence[HiddenEffect],
    searched: Search,
    found: Diagnosis,
    known: Run | None,
) -> BlindResult:
    """Return the result with the answers of the diagnosis; `known` is a run with the truth."""
    named = {missing.effect.name: missing.confused_with for missing in found.missing}
    twins = {name for names in named.values() for name in names}
    right = is_right(result.case, hidden, found)
    shown = [name for name, gain in zip(result.case.names, result.shown, strict=True) if gain > SHOWN]
    return replace(
        result,
        verdict=found.verdict,
        named=tuple(named),
        excuses=tuple(sorted(twins - set(named))),
        left=found.unexplained.what if found.unexplained is not None else '',
        is_right=right,
        is_excused=not right
        and is_excused(result.case.names, shown, found)
        and not _tells_apart(searched, known),
        errors_sigma=tuple(_errors_sigma(hidden, found)),
        drift_before_deg=_drift_deg(searched.first.run),
        drift_after_deg=_drift_deg(searched.last.run),
    )


def is_right(case: Case, hidden: Sequence[HiddenEffect], found: Diagnosis) -> bool:
    """Return True if the diagnosis is right.

    One hidden effect has to be named first, of several all and no other. For an effect out of the library,
    the time of its jump, the signal that it follows, or the effect that explains most of it has to be found.
    """
    named = [missing.effect.name for missing in found.missing]
    if not hidden:
        return found.verdict == 'nothing_missing'
    if case.names[0] not in OUT_OF_LIBRARY:
        return set(named) == set(case.names) if len(hidden) > 1 else named[:1] == list(case.names)
    structure, unknown = found.unexplained, OUT_OF_LIBRARY[case.names[0]]
    if unknown.right_signal is None:
        jump_s, found_s = hidden[0].values[1], structure.at_s if structure is not None else None
        return found_s is not None and abs(found_s - jump_s) < MOMENT_S
    if named[:1] == [unknown.right_effect]:
        return True
    return structure is not None and structure.shape.signal == unknown.right_signal


def is_excused(names: Sequence[str], shown: Sequence[str], found: Diagnosis) -> bool:
    """Return True if a diagnosis is as right as the recording allows.

    Each hidden effect that it shows is named or indistinguishable from a named one, and each one named
    stands for a hidden one. Of one hidden effect the first one named counts, as in `is_right`.
    """
    missing = found.missing if len(names) > 1 else found.missing[:1]
    stands_for = [{item.effect.name, *item.confused_with}.intersection(names) for item in missing]
    no_other = all(stands_for) and len(missing) <= len(names)
    return bool(names) and no_other and set().union(*stands_for) >= set(shown)


def _errors_sigma(hidden: Sequence[HiddenEffect], found: Diagnosis) -> Iterator[float]:
    for missing in found.missing:
        for item in hidden:
            if item.effect.name == missing.effect.name:
                for value, std, truth in zip(missing.values, missing.stds, item.values, strict=True):
                    yield float((value - truth) / std) if std > 0.0 else 0.0


def _with_noise(config: Config, factor: float) -> Config:
    gyro, wheels, camera = config.gyro, config.wheels, config.camera
    return replace(
        config,
        gyro=replace(
            gyro,
            rate_noise_deg_s=factor * gyro.rate_noise_deg_s,
            bias_walk_deg_s=factor * gyro.bias_walk_deg_s,
        ),
        wheels=replace(
            wheels,
            distance_noise_m=factor * wheels.distance_noise_m,
            lateral_noise_m=factor * wheels.lateral_noise_m,
            turn_noise_m=factor * wheels.turn_noise_m,
        ),
        camera=replace(camera, pixel_noise_px=factor * camera.pixel_noise_px),
        tracker=replace(config.tracker, noise_px=factor * config.tracker.noise_px),
    )


def _drift_deg(run: Run) -> float:
    """Return the held-out drift: in the second half, each span starts with the estimate of that time."""
    return blind_drift(run, from_s=0.5 * float(run.history.time_s[-1])).rms_deg


def _is_confident(result: BlindResult) -> bool:
    return result.verdict in ('effect_found', 'noise')


def _answer(result: BlindResult) -> str:
    """Return the named effects, or the verdict where there are none."""
    if result.verdict == 'unexplained':
        return f'unexplained ({result.left})'
    return ' + '.join(result.named) or result.verdict


def _share(cases: Sequence[bool]) -> float | None:
    return sum(cases) / len(cases) if cases else None


def _mean(values: Sequence[float]) -> float | None:
    known: Array = np.array([value for value in values if math.isfinite(value)])
    return float(known.mean()) if len(known) else None


def _run_task(task: tuple[Case, int, DiagnosisSettings, str | None, bool]) -> BlindResult:
    return run_blind(*task)
