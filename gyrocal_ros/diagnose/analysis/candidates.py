"""The candidate effects of a diagnosis: all that the model lacks and the recording can show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, IntArray, MotionBlock
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.covariate import covariate_bank, covariate_effects
from gyrocal_ros.effects.library import DISTURBANCES
from gyrocal_ros.effects.traits import (
    forms_of,
    is_estimated,
    scanned_coefficient,
    strengths,
    why_unobservable,
)
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.model.recording import RecordingSummary, Signal
from gyrocal_ros.model.sensor import (
    Coefficient,
    Effect,
    GyroTerm,
    Memory,
    Place,
    ScannedColumns,
    SensorModel,
    with_means,
)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect, as a linear combination of the columns that the filter carries."""

    effect: Effect
    """The effect as it would join the model."""
    carried: Effect
    weights: Array
    """(c, k) share of each of the c columns of `carried` in one unit of each coefficient of `effect`."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """All candidates of a diagnosis."""

    candidates: tuple[Candidate, ...]

    @property
    def carried(self) -> tuple[Effect, ...]:
        """Effects that the filter carries for them, each once."""
        return tuple({id(item.carried): item.carried for item in self.candidates}.values())

    def project(self, scores: ScoreStatistics) -> ScoreStatistics:
        """Convert the score statistics of what was carried, in its order, to those of the candidates."""
        carried = zip(self.carried, columns_of(scores.candidates), strict=True)
        places = {id(effect): columns for effect, columns in carried}
        effects = tuple(item.effect for item in self.candidates)
        mixing = np.zeros((scores.score.shape[1], sum(item.weights.shape[1] for item in self.candidates)))
        for item, columns in zip(self.candidates, columns_of(effects), strict=True):
            mixing[np.ix_(places[id(item.carried)], columns)] = item.weights
        information = mixing.T @ scores.information @ mixing
        features = None if scores.features is None else scores.features.mixed(mixing)
        return ScoreStatistics(effects, scores.start_s, information, scores.score @ mixing, features)


@dataclass(frozen=True)
class ScanBank:
    """A gyro effect at every value of its scan as one effect, with a coefficient for each column."""

    acts_on: ClassVar[Place] = 'gyro'
    effect: Effect
    name: str

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The linear coefficients of the effect, once for each value of the scan."""
        linear = [self.effect.coefficients[place] for place in strengths(self.effect)]
        return tuple(
            Coefficient(f'{item.name}_{row}', item.unit, item.prior_std)
            for row in range(len(self.scan))
            for item in linear
        )

    @cached_property
    def scan(self) -> Array:
        """(q,) values of the scanned coefficient."""
        place = scanned_coefficient(self.effect)
        assert place is not None
        return np.array(self.effect.coefficients[place].scan)

    @cached_property
    def _at_once(self) -> ScannedColumns | None:
        """The effect, if it computes the columns of all values at once; a protocol takes long to check."""
        return self.effect if isinstance(self.effect, ScannedColumns) else None

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Contribution and its derivative (N, q s) for s linear coefficients."""
        if self._at_once is not None:
            columns, memory = self._at_once.columns_at(block, self.scan, memory)
        else:
            columns, memory = self._one_by_one(block, memory)
        return GyroTerm(columns.dot(values), columns, memory)

    def _one_by_one(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        place, linear = scanned_coefficient(self.effect), strengths(self.effect)
        memories = memory if memory is not None else [None] * len(self.scan)
        values = np.zeros(len(self.effect.coefficients))
        columns, kept = [], []
        for value, before in zip(self.scan.tolist(), memories, strict=True):
            values[place] = value
            term = self.effect.contribute(block, values, before)  # type: ignore[attr-defined]
            columns.append(term.by_values[:, linear])
            kept.append(term.memory)
        return np.concatenate(columns, axis=1), kept


def candidates_for(model: SensorModel, recording: RecordingSummary) -> CandidateSet:
    """Collect every effect to try beside a model, one with a scan at each value of it."""
    present = {effect.name for effect in model.effects}
    found: list[Candidate] = []
    for name, effect in EFFECTS.items():
        if name in present or not is_estimated(effect) or why_unobservable(effect, recording):
            continue
        for number, form in enumerate(forms_of(effect), start=1):
            if scanned_coefficient(form) is None:
                found.append(Candidate(form, form, np.eye(len(form.coefficients))))
            else:
                found.extend(_scanned(form, f'{name} scan {number}'))
    if recording.signals:
        found.extend(item for item in _covariates(recording.signals) if item.effect.name not in present)
    return CandidateSet(tuple(found))


def with_disturbances(found: CandidateSet, recording: RecordingSummary) -> CandidateSet:
    """Return the candidates, and beside them what images show that is no fault of a sensor."""
    if recording.rig.camera is None:
        return found
    more = (Candidate(effect, effect, np.eye(len(effect.coefficients))) for effect in DISTURBANCES)
    return CandidateSet((*found.candidates, *more))


def columns_of(effects: Sequence[Effect]) -> list[IntArray]:
    """Return the indices of the coefficients of each effect among all."""
    ends = np.cumsum([0, *(len(effect.coefficients) for effect in effects)])
    return [np.arange(start, end) for start, end in zip(ends, ends[1:], strict=False)]


def _scanned(effect: Effect, bank_name: str) -> Iterator[Candidate]:
    """Yield a candidate for each value of the scan; all share one bank of that name."""
    bank, linear = ScanBank(effect, bank_name), strengths(effect)
    place = scanned_coefficient(effect)
    assert place is not None
    for row, value in enumerate(bank.scan.tolist()):
        values = np.zeros(len(effect.coefficients))
        weights = np.zeros((len(bank.coefficients), len(linear) + 1))
        values[place] = value
        weights[len(linear) * row + np.arange(len(linear)), linear] = 1.0
        yield Candidate(with_means(effect, values.tolist()), bank, weights)


def _covariates(signals: tuple[Signal, ...]) -> Iterator[Candidate]:
    """Yield the candidates that follow a recorded signal; all share one bank."""
    bank, effects = covariate_bank(signals), covariate_effects(signals)
    for row, effect in enumerate(effects):
        yield Candidate(effect, bank, np.eye(len(effects))[:, row : row + 1])
