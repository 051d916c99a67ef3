"""Blind trials: effects are hidden in recordings, and the diagnosis is compared with the truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.drift import blind_drift
from gyrocal_ros.diagnose.search import Search, search, with_effect
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.diagnose.summarise import summarise_recording
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.errors import FilterDivergedError
from gyrocal_ros.model.sensor import SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import LIBRARY_RANGES, OUT_OF_LIBRARY_RANGES, draw_hidden, draw_scale_factor, hide
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import stream
from gyrocal_ros.sim.world import SimSource

COSTLY_DRIFT_DEG = 0.5
COSTLY_SCALE = 2e-4
"""Blind drift and relative error of the scale factor below which the lack of an effect may be overlooked."""
WRONG_NOISE = 2.0
"""Factor by which the noise settings of the filter are wrong in two of the cases."""
PAIRS = 20
"""Number of cases of two effects at once."""
MOMENT_S = 5.0
"""Largest error of the moment of a jump that counts as right."""


@dataclass(frozen=True, slots=True)
class Case:
    """Effects to hide, and the factor by which the noise settings of the filter are wrong."""

    label: str
    names: tuple[str, ...] = ()
    noise: float = 1.0


@dataclass(frozen=True, slots=True)
class BlindResult:
    """Result of the diagnosis of one recording."""

    case: Case
    seed: int
    hidden: tuple[tuple[str, tuple[float, ...]], ...]
    """Names and true values."""
    is_costly: bool
    """True if the lack of any one of them costs more than may be overlooked."""
    drift_known_deg: float
    """Blind drift with the true sensor model."""
    verdict: str = 'diverged'
    named: tuple[str, ...] = ()
    """Names of the effects found, the one that explains most first."""
    excuses: tuple[str, ...] = ()
    """Names of effects that this recording cannot distinguish from them."""
    left: str = ''
    """Description of the unexplained structure; empty without."""
    is_right: bool = False
    is_excused: bool = False
    """True if it is not right, but all hidden effects are named or among the excuses."""
    errors_sigma: tuple[float, ...] = ()
    """Errors of the coefficients of the hidden effects that were found, in standard deviations."""
    drift_before_deg: float = math.nan
    drift_after_deg: float = math.nan


def cases(only: Sequence[str] = ()) -> list[Case]:
    """Return all cases, or those with the given labels.

    There is one for each effect of the library and out of it, one for nothing, two for nothing with wrong
    noise settings, and some for two effects at once.
    """
    rng = stream(0, 'pairs of effects')
    pairs = [rng.choice(list(LIBRARY_RANGES), 2, replace=False).tolist() for _ in range(PAIRS)]
    every = [
        Case('none'),
        Case('none, noise set too high', noise=WRONG_NOISE),
        Case('none, noise set too low', noise=1.0 / WRONG_NOISE),
        *(Case(name, (name,)) for name in (*LIBRARY_RANGES, *OUT_OF_LIBRARY_RANGES)),
        *(Case(' + '.join(pair), tuple(pair)) for pair in pairs),
    ]
    return [case for case in every if not only or case.label in only]


def blind(
    seeds: int, only: Sequence[str] = (), settings: DiagnosisSettings = DEFAULT_SETTINGS
) -> Iterator[dict[str, Any]]:
    """Yield a row for each case as it becomes ready, and one for all.

    Args:
        seeds: number of recordings of each case.
        only: labels of cases; empty for all.
        settings: thresholds of the diagnosis.
    """
    tasks = [(case, seed, settings) for case in cases(only) for seed in range(seeds)]
    every = []
    for _, group in groupby(in_parallel(_trial, tasks), key=lambda trial: trial.case):
        trials = list(group)
        every += trials
        yield row(trials[0].case.label, trials)
    yield row('all', every)


def row(label: str, trials: Sequence[BlindResult]) -> dict[str, Any]:
    """Return the figures of some recordings."""
    costly = [trial for trial in trials if trial.is_costly] if trials[0].case.names else list(trials)
    errors = np.abs([error for trial in trials for error in trial.errors_sigma])
    firsts = Counter(_said(trial) for trial in trials)
    return {
        'hidden': label,
        'bags': len(trials),
        'costly': len(costly),
        'right': _share([trial.is_right for trial in costly]),
        'or_twin': _share([trial.is_right or trial.is_excused for trial in costly]),
        'wrong': _share([_is_confident(trial) and not trial.is_right for trial in trials]),
        'in_3_sigma': _share((errors < 3.0).tolist()),
        'max_sigma': float(errors.max()) if len(errors) else None,
        'before_deg': _mean([trial.drift_before_deg for trial in trials]),
        'after_deg': _mean([trial.drift_after_deg for trial in trials]),
        'known_deg': _mean([trial.drift_known_deg for trial in trials]),
        'named': ', '.join(f'{name} {count}' for name, count in firsts.most_common()),
    }


def run_blind(case: Case, seed: int, settings: DiagnosisSettings = DEFAULT_SETTINGS) -> BlindResult:
    """Hide the effects of a case, simulate, diagnose, and compare with the truth."""
    scenario, config = find_scenario('cleaning'), _with_noise(Config(), case.noise)
    drawn = draw_hidden(seed, scenario.duration_s, case.names)
    scale_factor = draw_scale_factor(seed)
    scenario = replace(scenario, errors=replace(scenario.errors, scale_factor=scale_factor))
    simulated = SimSource(scenario, seed, hidden=hide(drawn, find_effect))
    source, config = preload(simulated, config, default_model())
    run, hidden = partial(calibrate, source, config), simulated.hidden
    recorded = summarise_recording(source)
    try:
        searched = search(
            default_model(), recorded, lambda model, tried: run(model, candidates=tried), settings=settings
        )
    except FilterDivergedError:
        searched = None

    def finished(model: SensorModel) -> Run:
        has_run = searched is not None and searched.first.model == model
        return searched.first.run if has_run else run(model)  # type: ignore[union-attr]

    known = _merit(finished, hidden, scale_factor)
    trial = BlindResult(
        case=case,
        seed=seed,
        hidden=tuple((item.effect.name, item.values) for item in hidden),
        is_costly=all(
            _merit(finished, hidden[:i] + hidden[i + 1 :], scale_factor).costs_more_than(known)
            for i in range(len(hidden))
        ),
        drift_known_deg=known.drift_deg,
    )
    return trial if searched is None else _judged(trial, hidden, searched, diagnose(searched, recorded))


@dataclass(frozen=True, slots=True)
class _Merit:
    """Errors of a sensor model on a recording with known truth."""

    drift_deg: float
    scale_error: float

    def costs_more_than(self, other: _Merit) -> bool:
        """Return True if a model is worse by more than may be overlooked; one that diverges (NaN) is."""
        cost_deg = math.sqrt(max(self.drift_deg**2 - other.drift_deg**2, 0.0))
        return not (cost_deg <= COSTLY_DRIFT_DEG and self.scale_error <= COSTLY_SCALE)


def _merit(run: Callable[[SensorModel], Run], hidden: Sequence[HiddenEffect], scale_factor: float) -> _Merit:
    """Run the model with some effects, with priors about the true coefficients."""
    model = default_model()
    for item in hidden:
        model = with_effect(model, with_means(item.effect, item.values))
    try:
        finished = run(model)
    except FilterDivergedError:
        return _Merit(math.nan, math.nan)
    scale_error = abs((1.0 + float(finished.state.coefficients[0])) / scale_factor - 1.0)
    return _Merit(_drift_deg(finished), scale_error)


def _judged(
    trial: BlindResult, hidden: Sequence[HiddenEffect], searched: Search, found: Diagnosis
) -> BlindResult:
    excuses = {finding.effect.name: finding.confused_with for finding in found.missing}
    right = is_right(trial.case, hidden, found)
    said = {*excuses, *(name for names in excuses.values() for name in names)}
    return replace(
        trial,
        verdict=found.verdict,
        named=tuple(excuses),
        excuses=tuple(sorted(said - set(excuses))),
        left=found.unexplained.what if found.unexplained is not None else '',
        is_right=right,
        is_excused=not right and bool(hidden) and said.issuperset(trial.case.names),
        errors_sigma=tuple(_errors_sigma(hidden, found)),
        drift_before_deg=_drift_deg(searched.first.run),
        drift_after_deg=_drift_deg(searched.last.run),
    )


def is_right(case: Case, hidden: Sequence[HiddenEffect], found: Diagnosis) -> bool:
    """Return True if the diagnosis is right.

    One hidden effect has to be named first, and of two both and no other. For an effect out of the library
    the moment of its jump, the signal that it goes with, or the effect that explains most of it is right.
    """
    named = [finding.effect.name for finding in found.missing]
    if not hidden:
        return found.verdict == 'nothing_missing'
    if case.names[0] not in OUT_OF_LIBRARY:
        return set(named) == set(case.names) if len(hidden) > 1 else named[:1] == list(case.names)
    left, unknown = found.unexplained, OUT_OF_LIBRARY[case.names[0]]
    if unknown.right_signal is None:
        moment_s = hidden[0].values[1]
        return left is not None and left.at_s is not None and abs(left.at_s - moment_s) < MOMENT_S
    if named[:1] == [unknown.right_effect]:
        return True
    return left is not None and left.shape.signal == unknown.right_signal


def _errors_sigma(hidden: Sequence[HiddenEffect], found: Diagnosis) -> Iterator[float]:
    for finding in found.missing:
        for item in hidden:
            if item.effect.name == finding.effect.name:
                for value, std, truth in zip(finding.values, finding.stds, item.values, strict=True):
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
    )


def _drift_deg(run: Run) -> float:
    """Return the held-out drift: in the second half, each span starts with the estimates of its beginning."""
    return blind_drift(run, from_s=0.5 * float(run.history.time_s[-1])).rms_deg


def _is_confident(trial: BlindResult) -> bool:
    return trial.verdict == 'effect_found'


def _said(trial: BlindResult) -> str:
    """Return the effects named, or the verdict."""
    if trial.verdict == 'unexplained':
        return f'unexplained ({trial.left})'
    return ' + '.join(trial.named) or trial.verdict


def _share(cases: Sequence[bool]) -> float | None:
    return sum(cases) / len(cases) if cases else None


def _mean(values: Sequence[float]) -> float | None:
    known: Array = np.array([value for value in values if math.isfinite(value)])
    return float(known.mean()) if len(known) else None


def _trial(task: tuple[Case, int, DiagnosisSettings]) -> BlindResult:
    return run_blind(*task)
