"""Candidate effects: every effect that the model lacks and the recording can show, and banks of scans."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from contracts import SIGNAL, eventful_blocks
from synthetic import RIG, readings, recording_of, score_statistics_of

from gyrocal_ros.data import Array, MotionBlock, Mount
from gyrocal_ros.diagnose.analysis.candidates import CandidateSet, ScanBank, candidates_for, columns_of
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bank, covariate_bias, covariate_effects
from gyrocal_ros.effects.traits import forms_of, is_limit, is_noise, required_signals
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.effects.wheel_scale import MIN_LEVER_M
from gyrocal_ros.model.recording import TEMPERATURE, RecordingSummary, Signal
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroTerm, Memory, Place, ScannedColumns, with_means
from gyrocal_ros.sim.scenarios import CAMERA

MEAN, SPREAD = 15.0, 0.5
SIGNALS = (SIGNAL, 'fan.data')
SOME = tuple(map(find_effect, ('scale_asymmetry', 'scale_quadratic', 'gyro_lag')))
LIMITS = {name for name, effect in EFFECTS.items() if is_limit(effect)}
SCANNED = (BiasWarmup(), TurnHysteresis(), TurnHysteresis(driven_by='side'))


def blocks_with_signals() -> list[MotionBlock]:
    """Return consecutive blocks in which both signals vary."""
    blocks = []
    for block in eventful_blocks():
        other = np.linspace(0.0, 5000.0, 12) + block.time_s[0]
        blocks.append(replace(block, covariates={**block.covariates, SIGNALS[1]: other}))
    return blocks


def derivatives(effect: Any) -> Array:
    """Return the derivatives (3, 12, k) of a gyro effect over some blocks, at its prior means."""
    parts, memory = [], None
    values = np.array([item.prior_mean for item in effect.coefficients])
    for block in blocks_with_signals():
        term = effect.contribute(block, values, memory)
        memory = term.memory
        parts.append(term.by_values)
    return np.array(parts)


def summary(
    *signals: str, recorded: tuple[str, ...] = (TEMPERATURE,), lever_m: float = 0.1
) -> RecordingSummary:
    """Summarise a recording with a camera and signals that vary."""
    rig = replace(RIG, camera=CAMERA, camera_mount=Mount(np.eye(3), np.array([lever_m, 0.0, 0.1])))
    varying = tuple(Signal(name, MEAN, SPREAD) for name in signals)
    bare = recording_of(readings(np.zeros(2)))
    return replace(bare, rig=rig, signals=varying, recorded=frozenset({*recorded, *signals}))


def names(found: CandidateSet) -> set[str]:
    return {item.effect.name for item in found.candidates}


class TestCandidatesFor:
    def test_every_effect_missing_in_the_model_is_a_candidate(self) -> None:
        found = names(candidates_for(default_model(), summary()))
        assert {'rate_saturation', 'rate_deadband'} == LIMITS
        noises = {name for name, effect in EFFECTS.items() if is_noise(effect)}
        assert found == set(EFFECTS) - {'scale_factor', *LIMITS, *noises}
        more = replace(default_model(), effects=(*default_model().effects, *SOME, BiasWarmup()))
        fewer = names(candidates_for(more, summary()))
        assert found - fewer == {'bias_warmup', *(effect.name for effect in SOME)}

    def test_an_effect_whose_signal_is_not_recorded_is_no_candidate(self) -> None:
        without = names(candidates_for(default_model(), summary(recorded=())))
        with_temperature = names(candidates_for(default_model(), summary()))
        expected = {name for name, effect in EFFECTS.items() if TEMPERATURE in required_signals(effect)}
        assert with_temperature - without == expected != set()

    def test_camera_effects_are_no_candidates_without_a_camera(self) -> None:
        camera = {name for name, effect in EFFECTS.items() if effect.acts_on in ('camera', 'shutter', 'time')}
        blind = replace(summary(), rig=replace(RIG, camera=None))
        with_camera, without = (names(candidates_for(default_model(), item)) for item in (summary(), blind))
        assert with_camera - without == camera | {'gyro_lag'}, 'a lag is an offset of the reference'

    @pytest.mark.parametrize(('part', 'is_candidate'), [(0.9, False), (1.1, True)])
    def test_wheel_scale_needs_a_camera_away_from_the_turning_centre(
        self, part: float, is_candidate: bool
    ) -> None:
        found = names(candidates_for(default_model(), summary(lever_m=part * MIN_LEVER_M)))
        assert ('wheel_scale' in found) == is_candidate

    def test_every_signal_is_tried_on_bias_and_scale(self) -> None:
        found = candidates_for(default_model(), summary(*SIGNALS)).candidates
        about = {item.effect.name: item.effect for item in found if ':' in item.effect.name}
        assert set(about) == {f'covariate_{of}:{signal}' for of in ('bias', 'scale') for signal in SIGNALS}
        assert about['covariate_bias:fan.data'] == covariate_bias('fan.data', MEAN, SPREAD)
        present = replace(default_model(), effects=(find_effect('covariate_bias:fan.data'),))
        left = names(candidates_for(present, summary('fan.data')))
        assert 'covariate_scale:fan.data' in left and 'covariate_bias:fan.data' not in left

    def test_the_values_of_a_scan_share_one_carried_effect(self) -> None:
        found = candidates_for(default_model(), summary())
        carried = [effect.name for effect in found.carried]
        assert len(carried) == len(set(carried)) < len(found.candidates)
        for name, forms in (('bias_warmup', 1), ('turn_hysteresis', 2)):
            scan = EFFECTS[name].coefficients[1].scan
            mine = [item for item in found.candidates if item.effect.name == name]
            assert [item.effect.coefficients[1].prior_mean for item in mine] == [*scan] * forms
            assert len({id(item.carried) for item in mine}) == forms == len(forms_of(EFFECTS[name]))

    def test_projected_scores_are_the_scores_of_the_candidates(self) -> None:
        found = candidates_for(default_model(), summary(*SIGNALS))
        assert len(found.carried) < len(found.candidates)
        rng = np.random.default_rng(0)
        others = {name: rng.normal(size=(3, 12, 4)) for name in EFFECTS}

        def columns(effects: tuple[Effect, ...]) -> Array:
            """(3, 12, c) derivatives of gyro effects by themselves; random numbers for all others."""
            parts = [
                derivatives(effect) if effect.acts_on == 'gyro' else others[effect.name] for effect in effects
            ]
            counts = [len(effect.coefficients) for effect in effects]
            return np.concatenate([part[:, :, :k] for part, k in zip(parts, counts, strict=True)], axis=2)

        tried, measured = tuple(item.effect for item in found.candidates), rng.normal(size=(3, 12))
        projected = found.project(score_statistics_of(columns(found.carried), measured, found.carried))
        expected = score_statistics_of(columns(tried), measured, tried)
        assert projected.candidates == tried and np.array_equal(projected.start_s, expected.start_s)
        np.testing.assert_allclose(projected.score, expected.score, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(projected.information, expected.information, rtol=1e-9, atol=1e-12)

    def test_columns_of_effects(self) -> None:
        effects: tuple[Effect, ...] = (SOME[0], find_effect('cross_axis'), SOME[1])
        assert [places.tolist() for places in columns_of(effects)] == [[0], [1, 2], [3]]
        assert columns_of(()) == []

    def test_other_prior_means_keep_the_standard_deviations(self) -> None:
        effect = with_means(find_effect('cross_axis'), (0.1, -0.2))
        assert [item.prior_mean for item in effect.coefficients] == [0.1, -0.2]
        assert with_means(effect, (0.0, 0.0)) == find_effect('cross_axis')


@dataclass(frozen=True)
class Pulse:
    """`(a + b w) exp(-t / tau)`: two linear coefficients, and a scanned one in the middle."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'pulse'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('a', 'rad/s', 0.1),
        Coefficient('tau', 's', 10.0, prior_mean=20.0, scan=(10.0, 20.0, 40.0)),
        Coefficient('b', '1', 0.1),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        decay, rate = np.exp(-block.time_s / values[1]), block.rate_rad_s[:, 2]
        added = (values[0] + values[2] * rate) * decay
        by_values = np.stack([decay, added * block.time_s / values[1] ** 2, rate * decay], axis=1)
        return GyroTerm(added, by_values)


class TestScanBank:
    """A column of a bank is the derivative of the effect itself at that value of the scan."""

    @pytest.mark.parametrize('effect', SCANNED, ids=repr)
    def test_columns_are_the_derivatives_of_the_effect(self, effect: Any) -> None:
        bank, memory = ScanBank(effect, 'bank'), None
        scan = effect.coefficients[1].scan
        assert len(bank.coefficients) == len(scan)
        memories: list[Memory] = [None] * len(scan)
        for block in eventful_blocks():
            term = bank.contribute(block, np.zeros(len(scan)), memory)
            memory = term.memory
            assert np.ptp(term.by_values) > 0.0 and not np.any(term.rate_rad_s)
            for place, value in enumerate(scan):
                own = effect.contribute(block, np.array([0.0, value]), memories[place])
                memories[place] = own.memory
                np.testing.assert_allclose(
                    term.by_values[:, place], own.by_values[:, 0], rtol=1e-9, atol=1e-15
                )

    def test_the_closed_form_of_warmup_is_exact(self) -> None:
        scan = BiasWarmup().coefficients[1].scan
        for block in eventful_blocks():
            term = ScanBank(BiasWarmup(), 'bank').contribute(block, np.zeros(len(scan)), None)
            for column, time_s in zip(term.by_values.T, scan, strict=True):
                own = BiasWarmup().contribute(block, np.array([0.0, time_s]), None).by_values
                np.testing.assert_allclose(column, own[:, 0], rtol=1e-12)

    @pytest.mark.parametrize('effect', SCANNED, ids=repr)
    def test_one_by_one_gives_the_columns_that_the_effect_gives_at_once(self, effect: Any) -> None:
        """An effect of a user's own need not have `columns_at`."""
        bank = ScanBank(effect, 'bank')
        assert isinstance(effect, ScannedColumns)
        at_once: Memory = None
        by_one: Memory = None
        for block in eventful_blocks():
            expected, at_once = effect.columns_at(block, bank.scan, at_once)
            columns, by_one = bank._one_by_one(block, by_one)
            assert columns.shape == (len(block.dt_s), len(bank.scan))
            np.testing.assert_allclose(columns, expected, rtol=1e-9, atol=1e-15)

    def test_several_linear_coefficients_about_a_scanned_one(self) -> None:
        (block, *_), effect = eventful_blocks(), Pulse()
        assert not isinstance(effect, ScannedColumns)
        bank = ScanBank(effect, 'bank')
        assert [item.unit for item in bank.coefficients] == ['rad/s', '1'] * 3
        columns = bank.contribute(block, np.zeros(6), None).by_values
        for row, value in enumerate((10.0, 20.0, 40.0)):
            own = effect.contribute(block, np.array([0.0, value, 0.0]), None).by_values
            np.testing.assert_allclose(columns[:, 2 * row : 2 * row + 2], own[:, [0, 2]], rtol=1e-12)

    def test_candidates_of_several_linear_coefficients(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(EFFECTS, 'pulse', Pulse())  # type: ignore[arg-type]
        found = [
            item
            for item in candidates_for(default_model(), summary()).candidates
            if item.effect.name == 'pulse'
        ]
        assert [item.effect.coefficients[1].prior_mean for item in found] == [10.0, 20.0, 40.0]
        for row, item in enumerate(found):
            weights = np.zeros((6, 3))
            weights[2 * row, 0] = weights[2 * row + 1, 2] = 1.0
            np.testing.assert_array_equal(item.weights, weights)


def test_the_bank_of_signals_is_every_covariate_effect() -> None:
    signals = [Signal(name, MEAN, SPREAD) for name in SIGNALS]
    bank = derivatives(covariate_bank(signals))
    expected = [derivatives(effect) for effect in covariate_effects(signals)]
    np.testing.assert_allclose(bank, np.concatenate(expected, axis=2), rtol=1e-12)
