"""What is put on trial: all that the model lacks and the recording can speak of, time constants in banks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contracts import SIGNAL, eventful_blocks
from gyrocal_ros.diagnose.banks import Hystereses, Warmups
from synthetic import RIG, readings, score_statistics_of

from gyrocal_ros.data import Array, Mount
from gyrocal_ros.diagnose.candidates import (
    HYSTERESIS_TIMES_S,
    LIMITS,
    MIN_LEVER_M,
    WARMUP_TIMES_S,
    candidate_set,
    columns_of,
    needs,
    with_means,
)
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bias
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.model.recording import RecordingSummary, Signal
from gyrocal_ros.model.sensor import Effect
from gyrocal_ros.sim.scenarios import CAMERA

MEAN, SPREAD = 15.0, 0.5
SIGNALS = (SIGNAL, 'fan.data')
SOME = tuple(map(find_effect, ('scale_asymmetry', 'scale_quadratic', 'gyro_lag')))


def contributed(effect: Any) -> Array:
    """(3, 12, k) derivatives of a gyro effect over some blocks, its coefficients as expected."""
    parts, memory = [], None
    for block in eventful_blocks():
        other = np.linspace(0.0, 5000.0, 12) + block.time_s[0]
        block = replace(block, covariates={**block.covariates, SIGNALS[1]: other})
        values = np.array([item.prior_mean for item in effect.coefficients])
        term = effect.contribute(block, values, memory)
        memory = term.memory
        parts.append(term.by_values)
    return np.array(parts)


class TestDocket:
    def offering(self, *signals: str, has_temperature: bool = True, lever_m: float = 0.1) -> RecordingSummary:
        rig = replace(RIG, camera=CAMERA, camera_mount=Mount(np.eye(3), np.array([lever_m, 0.0, 0.1])))
        offered = tuple(Signal(name, MEAN, SPREAD) for name in signals)
        return replace(readings(np.zeros(2)), rig=rig, signals=offered, has_temperature=has_temperature)

    def tried(self, *signals: str, has_temperature: bool = True, lever_m: float = 0.1) -> set[str]:
        offered = self.offering(*signals, has_temperature=has_temperature, lever_m=lever_m)
        return {trial.effect.name for trial in candidate_set(default_model(), offered).trials}

    def test_all_that_the_model_lacks_is_tried(self) -> None:
        tried = self.tried()
        assert tried == set(EFFECTS) - {'scale_factor', *LIMITS}
        more = replace(default_model(), effects=(*default_model().effects, *SOME, BiasWarmup()))
        fewer = {trial.effect.name for trial in candidate_set(more, self.offering()).trials}
        assert tried - fewer == {'bias_warmup', *(effect.name for effect in SOME)}

    def test_what_is_not_recorded_is_not_tried(self) -> None:
        cold = {
            trial.effect.name
            for trial in candidate_set(default_model(), self.offering(has_temperature=False)).trials
        }
        warm = {trial.effect.name for trial in candidate_set(default_model(), self.offering()).trials}
        assert (
            warm - cold
            == {name for name, effect in EFFECTS.items() if 'temperature' in needs(effect)}
            != set()
        )

    @pytest.mark.parametrize(('part', 'is_tried'), [(0.9, False), (1.1, True)])
    def test_a_camera_at_the_turning_centre_does_not_see_the_wheels(
        self, part: float, is_tried: bool
    ) -> None:
        trials = candidate_set(default_model(), self.offering(lever_m=part * MIN_LEVER_M)).trials
        assert ('wheel_scale' in {trial.effect.name for trial in trials}) == is_tried

    def test_every_signal_is_tried_on_bias_and_scale(self) -> None:
        trials = candidate_set(default_model(), self.offering(*SIGNALS)).trials
        about = {trial.effect.name: trial.effect for trial in trials if ':' in trial.effect.name}
        assert set(about) == {f'covariate_{of}:{signal}' for of in ('bias', 'scale') for signal in SIGNALS}
        assert about['covariate_bias:fan.data'] == covariate_bias('fan.data', MEAN, SPREAD)
        present = replace(default_model(), effects=(find_effect('covariate_bias:fan.data'),))
        left = {trial.effect.name for trial in candidate_set(present, self.offering('fan.data')).trials}
        assert 'covariate_scale:fan.data' in left and 'covariate_bias:fan.data' not in left

    def test_time_constants_share_what_the_filter_carries(self) -> None:
        every = candidate_set(default_model(), self.offering())
        carried = [effect.name for effect in every.carried]
        assert len(carried) == len(set(carried)) and {'warmups', 'hystereses'} <= set(carried)
        warmups = [trial.effect for trial in every.trials if trial.effect.name == 'bias_warmup']
        assert [effect.coefficients[1].prior_mean for effect in warmups] == list(WARMUP_TIMES_S)
        hystereses = [trial for trial in every.trials if trial.effect.name == 'turn_hysteresis']
        assert len(hystereses) == 2 * len(HYSTERESIS_TIMES_S)

    def test_evidence_of_what_is_carried_is_evidence_of_what_is_tried(self) -> None:
        every = candidate_set(default_model(), self.offering(*SIGNALS))
        assert len(every.carried) < len(every.trials)
        rng = np.random.default_rng(0)
        others = {name: rng.normal(size=(3, 12, 4)) for name in EFFECTS}

        def columns(effects: tuple[Effect, ...]) -> Array:
            """(3, 12, c) those of gyro effects by their own words, any others."""
            parts = [
                contributed(effect) if effect.acts_on == 'gyro' else others[effect.name] for effect in effects
            ]
            counts = [len(effect.coefficients) for effect in effects]
            return np.concatenate([part[:, :, :k] for part, k in zip(parts, counts, strict=True)], axis=2)

        tried, seen = tuple(trial.effect for trial in every.trials), rng.normal(size=(3, 12))
        judged = every.judged(score_statistics_of(columns(every.carried), seen, every.carried))
        expected = score_statistics_of(columns(tried), seen, tried)
        assert judged.candidates == tried and np.array_equal(judged.start_s, expected.start_s)
        np.testing.assert_allclose(judged.score, expected.score, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(judged.information, expected.information, rtol=1e-9, atol=1e-12)

    def test_places_of_coefficients(self) -> None:
        effects: tuple[Effect, ...] = (SOME[0], find_effect('cross_axis'), SOME[1])
        assert [places.tolist() for places in columns_of(effects)] == [[0], [1, 2], [3]]
        assert columns_of(()) == []

    def test_other_means_leave_the_doubts(self) -> None:
        effect = with_means(find_effect('cross_axis'), (0.1, -0.2))
        assert [item.prior_mean for item in effect.coefficients] == [0.1, -0.2]
        assert with_means(effect, (0.0, 0.0)) == find_effect('cross_axis')


class TestBanks:
    """A column of a bank is what the effect itself says at that time constant."""

    def test_warmups(self) -> None:
        bank = Warmups(WARMUP_TIMES_S)
        for block in eventful_blocks():
            term = bank.contribute(block, np.zeros(len(WARMUP_TIMES_S)), None)
            assert not np.any(term.rate_rad_s)
            for column, time_s in zip(term.by_values.T, WARMUP_TIMES_S, strict=True):
                own = BiasWarmup().contribute(block, np.array([0.0, time_s]), None).by_values
                np.testing.assert_allclose(column, own[:, 0], rtol=1e-12)

    def test_hystereses_remember_from_block_to_block(self) -> None:
        forms = (TurnHysteresis(), TurnHysteresis(driven_by='side'))
        variants = tuple(with_means(form, (0.0, time_s)) for form in forms for time_s in HYSTERESIS_TIMES_S)
        bank, memory = Hystereses(variants), None
        memories: list[object] = [None] * len(variants)
        for block in eventful_blocks():
            term = bank.contribute(block, np.zeros(len(variants)), memory)
            memory = term.memory
            assert np.ptp(term.by_values) > 0.0 and not np.any(term.rate_rad_s)
            for place, variant in enumerate(variants):
                values = np.array([0.0, variant.coefficients[1].prior_mean])
                own = variant.contribute(block, values, memories[place])
                memories[place] = own.memory
                np.testing.assert_allclose(
                    term.by_values[:, place], own.by_values[:, 0], rtol=1e-9, atol=1e-15
                )
        assert len(bank.coefficients) == len(variants)
