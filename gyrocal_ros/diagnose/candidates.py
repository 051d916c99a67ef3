"""Which effects are put on trial: all that the model lacks and the recording can speak of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from gyrocal_ros.data import Array, IntArray, Rig
from gyrocal_ros.diagnose.banks import Followers, Hystereses, Warmups
from gyrocal_ros.diagnose.recorded import Recorded, Signal
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.ekf.score_statistics import ScoreStatistics
from gyrocal_ros.model.sensor import Effect, SensorModel

WARMUP_TIMES_S = (40.0, 65.0, 105.0, 170.0, 275.0, 445.0, 720.0, 1160.0)
HYSTERESIS_TIMES_S = (2.5, 4.0, 6.5, 10.5, 17.0, 27.5, 44.5)
"""Geometric series."""
E = TypeVar('E', bound=Effect)

LIMITS = ('rate_saturation', 'rate_deadband')
"""Effects that enter by a limit: told by the readings, not by sensitivities."""
MIN_LEVER_M = 0.01
"""A distance from the turning centre that is shorter is not known well enough to measure others by."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect on trial, as a mixture of what the filter carries."""

    effect: Effect
    """As it would join the model."""
    carried: Effect
    weights: Array
    """(c, k) how much of each of the c columns of `carried` one unit of each coefficient is."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """All effects on trial."""

    trials: tuple[Candidate, ...]

    @property
    def carried(self) -> tuple[Effect, ...]:
        """What the filter has to carry along for them, each once."""
        return tuple({id(trial.carried): trial.carried for trial in self.trials}.values())

    def judged(self, scores: ScoreStatistics) -> ScoreStatistics:
        """The evidence of what was carried, as evidence of the effects on trial."""
        carried = zip(scores.candidates, columns_of(scores.candidates), strict=True)
        places = {id(effect): columns for effect, columns in carried}
        mixing = np.zeros((scores.score.shape[1], sum(trial.weights.shape[1] for trial in self.trials)))
        effects = tuple(trial.effect for trial in self.trials)
        for trial, columns in zip(self.trials, columns_of(effects), strict=True):
            mixing[np.ix_(places[id(trial.carried)], columns)] = trial.weights
        information = mixing.T @ scores.information @ mixing
        return ScoreStatistics(effects, scores.start_s, information, scores.score @ mixing)


def candidate_set(model: SensorModel, recorded: Recorded) -> CandidateSet:
    """Every effect to try beside a model; one with a time constant is tried at several values of it."""
    present = {effect.name for effect in model.effects}
    trials: list[Candidate] = []
    for name, effect in EFFECTS.items():
        if name in present or name in LIMITS or not set(needs(effect)) <= recorded.extras:
            continue
        if name == 'wheel_scale' and not has_lever(recorded.rig):
            continue
        if isinstance(effect, BiasWarmup):
            trials.extend(_warmups(effect))
        elif isinstance(effect, TurnHysteresis):
            trials.extend(_hystereses(effect))
        else:
            trials.append(_plain(effect))
    trials.extend(trial for trial in _followers(recorded.signals) if trial.effect.name not in present)
    return CandidateSet(tuple(trials))


def columns_of(effects: Sequence[Effect]) -> list[IntArray]:
    """Where the coefficients of each effect stand among all, as index arrays."""
    ends = np.cumsum([0, *(len(effect.coefficients) for effect in effects)])
    return [np.arange(start, end) for start, end in zip(ends, ends[1:], strict=False)]


def needs(effect: Effect) -> tuple[str, ...]:
    """What an effect needs beside IMU, wheels and camera."""
    about = getattr(effect, 'about', None)
    return about.needs if about is not None else ()


def has_lever(rig: Rig) -> bool:
    """Whether a camera is far enough from the turning centre to show how long the odometer's metre is."""
    return rig.camera is not None and bool(np.hypot(*rig.camera_mount.p_bs[:2]) >= MIN_LEVER_M)


def _plain(effect: Effect) -> Candidate:
    return Candidate(effect, effect, np.eye(len(effect.coefficients)))


def _warmups(effect: BiasWarmup) -> list[Candidate]:
    bank = Warmups(WARMUP_TIMES_S)
    return [
        Candidate(with_means(effect, (0.0, time_s)), bank, _one_of(row, len(WARMUP_TIMES_S), 2))
        for row, time_s in enumerate(WARMUP_TIMES_S)
    ]


def _hystereses(effect: TurnHysteresis) -> list[Candidate]:
    forms = (replace(effect, driven_by='rate'), replace(effect, driven_by='side'))
    variants = tuple(with_means(form, (0.0, time_s)) for form in forms for time_s in HYSTERESIS_TIMES_S)
    bank = Hystereses(variants)
    return [Candidate(variant, bank, _one_of(row, len(variants), 2)) for row, variant in enumerate(variants)]


def _one_of(row: int, count: int, coefficients: int) -> Array:
    """(count, coefficients): the first is column `row` of a bank; nothing depends on a time constant yet."""
    weights = np.zeros((count, coefficients))
    weights[row, 0] = 1.0
    return weights


def _followers(signals: Sequence[Signal]) -> list[Candidate]:
    bank = Followers(tuple((signal.name, signal.mean) for signal in signals))
    effects = [
        make(signal.name, signal.mean, signal.spread)
        for make in (covariate_bias, covariate_scale)
        for signal in signals
    ]
    return [Candidate(effect, bank, _one_of(row, len(effects), 1)) for row, effect in enumerate(effects)]


def with_means(effect: E, values: Sequence[float]) -> E:
    """The effect, its coefficients expected at other values; the doubts stay."""
    items = zip(effect.coefficients, values, strict=True)
    moved = tuple(replace(item, prior_mean=float(value)) for item, value in items)
    return replace(effect, coefficients=moved)  # type: ignore[type-var,no-any-return]
