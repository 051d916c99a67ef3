"""Information of each test drive on each effect, and the correlations of effects, by simulation.

One run of the filter over a simulated drive, with every effect as a candidate, gives Lambda, the information
on all of them at once (`ekf.history.score_statistics`). All figures follow from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from gyrocal_ros.bench.accuracy import in_parallel
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, IntArray, MotionBlock
from gyrocal_ros.diagnose.analysis.candidate_fit import correlation
from gyrocal_ros.diagnose.analysis.candidates import Candidate, CandidateSet, candidates_for, columns_of
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.separability import MAX_UNLISTED_CORRELATION, kind_of
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS
from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS, SCALE_FACTOR
from gyrocal_ros.effects.base import LinearGyroEffect, column
from gyrocal_ros.effects.traits import is_limit, scanned_coefficient
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.recording import Signal
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroEffectOnReadings, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.drives import CONTROLS, EVERYDAY, TEST_DRIVES
from gyrocal_ros.sim.scenarios import Scenario
from gyrocal_ros.sim.world import SimSource

BARE = SensorModel('bare', BiasModel(), ())
"""Sensor model without a scale factor, so that correlations with the scale factor can be computed."""
DRIVES: dict[str, Scenario] = {EVERYDAY.name: EVERYDAY, **TEST_DRIVES}
COLUMNS: dict[str, Scenario] = {**DRIVES, **CONTROLS}
"""Columns of the table."""
SIGNAL = Signal('fan_speed.data', mean=10000.0, spread=3200.0)
"""Example of a recorded signal; the spread is that of a cleaning robot."""


@dataclass(frozen=True)
class Lost(LinearGyroEffect):
    """Part of the rate that a limit of usual size removes from the readings; the coefficient is 1 for it.

    Nothing depends smoothly on a limit, but the removed part has a shape that may be correlated with others.
    """

    limit: GyroEffectOnReadings
    values: tuple[float, ...]
    name: str
    coefficients: tuple[Coefficient, ...] = (Coefficient('part', '1', prior_std=1.0),)

    def columns(self, block: MotionBlock) -> Array:
        """Return the column (N, 1)."""
        rate = block.rate_rad_s[:, 2]
        return column(rate - self.limit.readings(rate, block.dt_s, np.array(self.values), 1.0))


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of one drive."""

    shows: dict[str, float]
    """Sigma of the usual size of each effect, with scale factor and bias estimated."""
    alike: dict[tuple[str, str], float]
    """Correlation of each pair of effects of which both are significant."""


Variant = tuple[Effect, IntArray]
"""An effect with one time constant of several, and its columns of Lambda."""


def figures(drive: str) -> Figures:
    """Run the filter over a drive and compute the figures from Lambda."""
    scores = _scores(drive)
    variants: dict[str, list[Variant]] = {}
    for effect, columns in zip(scores.candidates, columns_of(scores.candidates), strict=True):
        variants.setdefault(kind_of(effect.name), []).append((effect, columns))
    usual = {name: min(found, key=_distance_from_usual) for name, found in variants.items()}
    scale_free = _marginalised(scores, usual[SCALE_FACTOR][1])
    at_all = {name: _sigma(scores, variant) for name, variant in usual.items()}
    beside_scale = {name: _sigma(scale_free, variant) for name, variant in usual.items()}
    alike = {}
    for first, second in combinations(sorted(usual), 2):
        with_scale = SCALE_FACTOR in (first, second)
        information, shows = (scores, at_all) if with_scale else (scale_free, beside_scale)
        if min(shows[first], shows[second]) > DEFAULT_SETTINGS.significant_sigma:
            alike[first, second] = max(
                correlation(information, usual[one][1], columns)
                for one, other in ((first, second), (second, first))
                for _, columns in variants[other]
            )
    return Figures(beside_scale | {SCALE_FACTOR: at_all[SCALE_FACTOR]}, alike)


def motions() -> Iterator[dict[str, Any]]:
    """Yield the rows of the table, one column per drive: sigma of an effect, correlation of two effects.

    The sigma is that of an effect of usual size after five minutes, with scale factor and bias estimated. Two
    effects have a row if the library lists them as twins or if they are correlated in some drive; its entry
    is empty for drives in which one of them is not significant.
    """
    every: dict[str, Figures] = dict(zip(COLUMNS, in_parallel(figures, COLUMNS), strict=True))
    for effect in (*EFFECTS, *COVARIATE_EFFECTS):
        sigmas = {name: float(f'{found.shows.get(effect, 0.0):.4g}') for name, found in every.items()}
        yield sigmas | {'effect': effect}
    for pair in sorted(_declared_twins() | _found_twins(every)):
        correlations = {name: found.alike.get(pair) for name, found in every.items()}
        rounded = {name: None if value is None else round(value, 6) for name, value in correlations.items()}
        yield rounded | {'effect': '/'.join(pair)}


def _scores(drive: str) -> ScoreStatistics:
    """Return the score statistics of every effect, from a robot whose scale factor is right."""
    scenario = COLUMNS[drive]
    source = SimSource(replace(scenario, errors=replace(scenario.errors, scale_factor=1.0)), seed=0)
    candidates = candidates_for(BARE, replace(summarise_recording(source), signals=(SIGNAL,))).candidates
    limits = [effect for effect in EFFECTS.values() if is_limit(effect)]
    lost = [Lost(effect, effect.about.example, effect.name) for effect in limits]  # type: ignore[arg-type]
    every = CandidateSet((*candidates, *(Candidate(effect, effect, np.eye(1)) for effect in lost)))
    run = calibrate(source, Config(), BARE, candidates=every.carried)
    assert run.scores is not None
    return every.project(run.scores)


def _marginalised(scores: ScoreStatistics, columns: IntArray) -> ScoreStatistics:
    """Return the information on all others when some coefficients are estimated (Schur complement)."""
    total = scores.information.sum(axis=0)
    cross = total[:, columns]
    remaining = total - cross @ np.linalg.solve(total[np.ix_(columns, columns)], cross.T)
    return replace(scores, information=remaining[None])


def _sigma(scores: ScoreStatistics, variant: Variant) -> float:
    """Return the sigma of an effect of usual size, as root mean square over the signs of its coefficients."""
    effect, columns = variant
    information = np.maximum(np.diagonal(scores.information.sum(axis=0))[columns], 0.0)
    return math.sqrt(float(np.square(_usual_values(effect)) @ information))


def _usual_values(effect: Effect) -> Array:
    if effect.name in EFFECTS and not isinstance(effect, Lost):
        return np.array(EFFECTS[effect.name].about.example)
    return np.array([item.prior_std for item in effect.coefficients])


def _distance_from_usual(variant: Variant) -> float:
    """Return the logarithmic distance of a time constant from its usual value; zero where there is none."""
    effect, _ = variant
    place = None if isinstance(effect, Lost) else scanned_coefficient(effect)
    if place is None:
        return 0.0
    return abs(math.log(effect.coefficients[place].prior_mean / EFFECTS[effect.name].about.example[place]))


def _declared_twins() -> set[tuple[str, str]]:
    """Return the pairs that the library lists as twins."""
    known = {*EFFECTS, *COVARIATE_EFFECTS}
    pairs = {(name, twin) for name, effect in EFFECTS.items() for twin in effect.about.twins}
    return {(min(pair), max(pair)) for pair in pairs if known.issuperset(pair)}


def _found_twins(every: dict[str, Figures]) -> set[tuple[str, str]]:
    return {
        pair
        for drive in DRIVES
        for pair, value in every[drive].alike.items()
        if value > MAX_UNLISTED_CORRELATION
    }
