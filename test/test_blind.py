"""Blind trials: the cases, the right answers, the figures of a row, and one short trial."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from synthetic import drive

from gyrocal_ros.bench import blind as bench
from gyrocal_ros.bench.accuracy import first_seeds
from gyrocal_ros.bench.blind import MOMENT_S, BlindResult, blind, is_excused, is_right, row, run_blind
from gyrocal_ros.bench.blind_cases import PAIRS, TRIPLES, WRONG_NOISE, Case, cases
from gyrocal_ros.diagnose.analysis.model_fit import ModelFit
from gyrocal_ros.diagnose.analysis.shapes import UnexplainedStructure, shapes
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.model.recording import SPEED_SIGNAL
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import LIBRARY_RANGES, NOISES, OUT_OF_LIBRARY_RANGES
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY, VOLTAGE
from gyrocal_ros.sim.scenarios import find_scenario


class TestCases:
    def test_the_cases_are_nothing_every_effect_pairs_and_effects_out_of_the_library(self) -> None:
        every = cases()
        assert [case.label for case in every if not case.names and case.noise == 1.0] == ['none']
        assert sorted(case.noise for case in every if case.noise != 1.0) == [1.0 / WRONG_NOISE, WRONG_NOISE]
        assert {case.names[0] for case in every if len(case.names) == 1} == {
            *LIBRARY_RANGES,
            *OUT_OF_LIBRARY_RANGES,
        }
        pairs = [case.names for case in every if len(case.names) == 2]
        triples = [case.names for case in every if len(case.names) == 3]
        assert len(triples) == TRIPLES and all(len(set(names)) == 3 for names in triples)
        assert not {name for names in triples for name in names} & NOISES
        assert len(pairs) == PAIRS and all(first != second for first, second in pairs)
        assert {name for pair in pairs for name in pair} <= set(LIBRARY_RANGES)
        assert len({case.label for case in every}) == len(every)
        assert cases() == every, 'the same each time'

    def test_no_two_recordings_share_a_seed(self) -> None:
        assert first_seeds(['a', 'b', 'c'], 4) == {'a': 0, 'b': 4, 'c': 8}

    def test_every_effect_of_the_library_can_be_hidden(self) -> None:
        assert {name for name in LIBRARY_RANGES if ':' not in name} == set(EFFECTS) - {'scale_factor'}


def finding(effect: Effect, *confused_with: str, **changes: Any) -> MissingEffect:
    count = len(effect.coefficients)
    found = MissingEffect(effect, np.zeros(count), np.ones(count), 9.0, 5.0, 1e-6, 1.0, 0.5, confused_with)
    return replace(found, **changes)


def diagnosed(
    *names: str, verdict: str = 'effect_found', left: UnexplainedStructure | None = None
) -> Diagnosis:
    missing = tuple(finding(find_effect(name)) for name in names)
    return Diagnosis(verdict, missing, (), {}, left, (), ModelFit((), True), 'ground truth')


def hidden(*names: str) -> tuple[Case, list[HiddenEffect]]:
    effects = [OUT_OF_LIBRARY.get(name) or find_effect(name) for name in names]
    items = [HiddenEffect(effect, (1.0,) * len(effect.coefficients)) for effect in effects]
    return Case(' + '.join(names), names), items


@cache
def structure(signal: str, at_s: float | None = None) -> UnexplainedStructure:
    """Make unexplained structure that goes with a signal."""
    made = drive(duration_s=60.0, signals={signal: np.linspace(0.0, 1.0, 600)})
    shape = next(item for item in shapes(made.run, made.seen) if item.signal == signal)
    return UnexplainedStructure('structure', 50.0, 9.0, shape, at_s)


class TestIsRight:
    def test_nothing(self) -> None:
        assert is_right(Case('none'), [], diagnosed(verdict='nothing_missing'))
        assert not is_right(Case('none'), [], diagnosed('gyro_lag'))
        assert not is_right(Case('none'), [], diagnosed(verdict='cannot_tell'))

    def test_one_effect_has_to_be_named_first(self) -> None:
        one = hidden('gyro_lag')
        assert is_right(*one, diagnosed('gyro_lag')) and is_right(*one, diagnosed('gyro_lag', 'scale_cubic'))
        assert not is_right(*one, diagnosed('scale_cubic', 'gyro_lag'))
        assert not is_right(*one, diagnosed(verdict='nothing_missing'))

    def test_of_two_effects_both_have_to_be_named_and_no_third(self) -> None:
        two = hidden('gyro_lag', 'scale_cubic')
        assert is_right(*two, diagnosed('scale_cubic', 'gyro_lag'))
        assert not is_right(*two, diagnosed('gyro_lag'))
        assert not is_right(*two, diagnosed('gyro_lag', 'scale_cubic', 'turn_slip'))

    @pytest.mark.parametrize(('late_s', 'right'), [(0.9 * MOMENT_S, True), (1.1 * MOMENT_S, False)])
    def test_the_moment_of_a_jump_has_to_be_right(self, late_s: float, right: bool) -> None:
        case, (knock,) = hidden('stranger_knock')
        knock = replace(knock, values=(0.01, 150.0))
        unknown = structure('time since the start (s)', 150.0 + late_s)
        assert is_right(case, [knock], diagnosed(verdict='unexplained', left=unknown)) == right
        assert not is_right(case, [knock], diagnosed(verdict='unexplained', left=replace(unknown, at_s=None)))
        assert not is_right(case, [knock], diagnosed('bias_temperature'))

    @pytest.mark.parametrize(
        ('name', 'effect', 'signal'),
        [
            ('stranger_speed_bias', f'covariate_bias:{SPEED_SIGNAL}', SPEED_SIGNAL),
            ('stranger_supply_kink', f'covariate_scale:{VOLTAGE}', VOLTAGE),
        ],
    )
    def test_out_of_the_library_an_effect_or_the_signal_is_right(
        self, name: str, effect: str, signal: str
    ) -> None:
        unknown = hidden(name)
        assert (OUT_OF_LIBRARY[name].right_effect, OUT_OF_LIBRARY[name].right_signal) == (effect, signal)
        assert is_right(*unknown, diagnosed(effect))
        assert is_right(*unknown, diagnosed(verdict='unexplained', left=structure(signal)))
        assert not is_right(*unknown, diagnosed(verdict='unexplained', left=structure('another')))
        assert not is_right(*unknown, diagnosed('gyro_lag', effect))
        assert not is_right(*unknown, diagnosed(verdict='nothing_missing'))

    def test_every_effect_out_of_the_library_has_a_right_answer(self) -> None:
        assert set(OUT_OF_LIBRARY) == set(OUT_OF_LIBRARY_RANGES)
        with_signal = {name for name, effect in OUT_OF_LIBRARY.items() if effect.right_signal is not None}
        assert set(OUT_OF_LIBRARY) - with_signal == {'stranger_knock'}
        assert all(OUT_OF_LIBRARY[name].right_effect for name in with_signal)


class TestIsExcused:
    """A twin excuses for one hidden effect that is not named, and never for one named besides."""

    WARM_UP = finding(find_effect('bias_warmup'), 'bias_temperature')
    LAG = finding(find_effect('gyro_lag'), 'camera_time_offset')

    @staticmethod
    def excused(
        names: tuple[str, ...], *missing: MissingEffect, shown: tuple[str, ...] | None = None
    ) -> bool:
        return is_excused(names, names if shown is None else shown, replace(diagnosed(), missing=missing))

    def test_a_twin_is_as_right_as_the_recording_allows(self) -> None:
        two = ('gyro_lag', 'bias_temperature')
        assert self.excused(two, self.LAG, self.WARM_UP)
        assert not self.excused(two, self.WARM_UP), 'one missed'
        assert not self.excused(two) and not self.excused((), self.LAG)

    def test_one_named_for_two_that_are_the_same_here(self) -> None:
        both = finding(find_effect('wheel_scale'), 'camera_position')
        assert self.excused(('wheel_scale', 'camera_position'), both)

    def test_a_third_effect_is_no_twin(self) -> None:
        two, cubic = ('bias_temperature', 'scale_cubic'), finding(find_effect('scale_cubic'))
        again = finding(find_effect('scale_asymmetry'), 'scale_cubic')
        assert self.excused(two, self.WARM_UP, cubic)
        assert not self.excused(two, self.WARM_UP, cubic, self.LAG)
        assert not self.excused(two, self.WARM_UP, cubic, again)

    def test_what_the_recording_does_not_show_need_not_be_named(self) -> None:
        two = ('gyro_lag', 'bias_temperature')
        assert self.excused(two, self.LAG, shown=('gyro_lag',))
        assert self.excused(two, self.LAG, self.WARM_UP, shown=('gyro_lag',))
        cubic = finding(find_effect('scale_cubic'))
        assert not self.excused(two, self.LAG, cubic, shown=('gyro_lag',)), 'it stands for none'

    def test_of_one_hidden_effect_the_first_named_counts(self) -> None:
        cubic = finding(find_effect('scale_cubic'))
        assert self.excused(('bias_temperature',), self.WARM_UP, cubic)
        assert not self.excused(('bias_temperature',), cubic, self.WARM_UP)


LAG = Case('gyro_lag', ('gyro_lag',))
RIGHT = BlindResult(
    LAG,
    0,
    (('gyro_lag', (0.02,)),),
    is_costly=True,
    shown=(900.0,),
    drift_known_deg=0.1,
    verdict='effect_found',
    named=('gyro_lag',),
    is_right=True,
    errors_sigma=(0.5, -2.0),
    drift_before_deg=2.0,
    drift_after_deg=0.2,
)
TWIN = replace(
    RIGHT,
    verdict='cannot_tell',
    named=('camera_time_offset',),
    is_right=False,
    is_excused=True,
    errors_sigma=(),
)
WRONG = replace(RIGHT, named=('scale_cubic', 'turn_slip'), is_right=False, errors_sigma=(-4.0,))
MISSED = replace(
    WRONG, is_costly=False, verdict='nothing_missing', named=(), errors_sigma=(), drift_after_deg=2.0
)
DIVERGED = BlindResult(LAG, 9, RIGHT.hidden, is_costly=True, shown=(900.0,), drift_known_deg=0.3)


class TestRow:
    def test_shares_of_costly_recordings_and_means_over_all(self) -> None:
        found = row('gyro_lag', [RIGHT, TWIN, WRONG, MISSED])
        assert (found['hidden'], found['bags'], found['costly']) == ('gyro_lag', 4, 3)
        assert found['right'] == pytest.approx(1 / 3) and found['or_twin'] == pytest.approx(2 / 3)
        assert found['wrong'] == pytest.approx(1 / 4), 'confident, and not right'
        assert found['in_3_sigma'] == pytest.approx(2 / 3) and found['max_sigma'] == 4.0
        assert found['before_deg'] == pytest.approx(2.0) and found['known_deg'] == pytest.approx(0.1)
        assert found['after_deg'] == pytest.approx((0.2 + 0.2 + 0.2 + 2.0) / 4)

    def test_the_effects_named_are_counted(self) -> None:
        left = replace(MISSED, verdict='unexplained', left='the bias jumped')
        named = row('x', [RIGHT, RIGHT, WRONG, MISSED, left, DIVERGED])['named']
        assert named.split(', ') == [
            'gyro_lag 2',
            'scale_cubic + turn_slip 1',
            'nothing_missing 1',
            'unexplained (the bias jumped) 1',
            'diverged 1',
        ]

    def test_unknown_figures_are_empty(self) -> None:
        found = row('gyro_lag', [replace(MISSED, is_right=False)])
        assert found['right'] is found['or_twin'] is found['in_3_sigma'] is found['max_sigma'] is None
        assert found['wrong'] == 0.0

    def test_a_filter_that_diverged_is_not_right(self) -> None:
        found = row('gyro_lag', [RIGHT, DIVERGED])
        assert found['right'] == 0.5 and found['wrong'] == 0.0
        assert found['before_deg'] == 2.0 and found['known_deg'] == pytest.approx(0.2)

    def test_where_nothing_is_hidden_every_recording_counts(self) -> None:
        quiet = replace(MISSED, case=Case('none'), hidden=(), is_right=True)
        alarm = replace(WRONG, case=Case('none'), hidden=(), is_costly=False)
        found = row('none', [quiet, quiet, quiet, alarm])
        assert found['costly'] == 4 and found['right'] == 0.75 and found['wrong'] == 0.25

    def test_one_row_a_case_and_one_of_all(self, monkeypatch: pytest.MonkeyPatch) -> None:
        trials = {'none': replace(MISSED, case=Case('none'), is_right=True), 'gyro_lag': RIGHT}

        scenes, seeds = [], []

        def in_order(
            function: object, tasks: list[tuple[Case, int, DiagnosisSettings, str | None, bool]]
        ) -> Iterator[BlindResult]:
            for case, seed, _, scene, _ in tasks:
                scenes.append(scene)
                seeds.append(seed)
                yield replace(trials[case.label], case=case, seed=seed)

        monkeypatch.setattr(bench, 'in_parallel', in_order)
        rows = list(blind(2, ['none', 'gyro_lag']))
        place = [case.label for case in cases()].index('gyro_lag')
        assert scenes == [None] * 4 and seeds == [0, 1, 2 * place, 2 * place + 1]
        assert [(found['hidden'], found['bags']) for found in rows] == [
            ('none', 2),
            ('gyro_lag', 2),
            ('all', 4),
        ]
        scenes.clear()
        list(blind(3, ['none'], scenes=['tiles', 'fisheye']))
        assert scenes == ['tiles', 'fisheye', 'tiles'], 'one scene for each recording'


@pytest.mark.parametrize(
    ('drift_deg', 'scale_error', 'known_deg', 'is_worse'),
    [
        (1.0, 0.0, 0.1, True),
        (0.4, 1e-4, 0.1, False),
        (0.1, 3e-4, 0.1, True),
        (math.nan, math.nan, 0.1, True),
        (math.nan, 1e-4, math.nan, False),
        (math.nan, 3e-4, math.nan, True),
    ],
)
def test_an_omission_costs_drift_or_scale(
    drift_deg: float, scale_error: float, known_deg: float, is_worse: bool
) -> None:
    """A run that diverges costs, but not a recording that is too short for a blind minute."""
    known = bench._ModelError(known_deg, 0.0)
    assert bench._ModelError(drift_deg, scale_error).is_much_worse_than(known) == is_worse


def test_the_truth_is_known_to_the_filter_in_its_time_constants_alone() -> None:
    values = {'turn_hysteresis': (0.1, 20.0), 'rate_deadband': (0.003,)}
    hidden = [HiddenEffect(find_effect(name), those) for name, those in values.items()]
    models: list[SensorModel] = []
    assert bench._with_truth(models.append, default_model(), hidden) is None  # type: ignore[arg-type]
    by_name = {effect.name: effect.coefficients for effect in models[0].effects}
    strength, tau = by_name['turn_hysteresis']
    assert strength.prior_std == find_effect('turn_hysteresis').coefficients[0].prior_std
    assert tau.prior_mean == 20.0 and tau.prior_std == pytest.approx(4.0)
    assert by_name['rate_deadband'][0].prior_std == 0.0, 'no filter estimates a limit'


@pytest.fixture(scope='module')
def short() -> BlindResult:
    """Two minutes that hide an effect: just long enough for a blind minute in the second half."""
    scenario = replace(find_scenario('cleaning'), duration_s=124.0, imu_hz=100, camera_hz=5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, 'find_scenario', lambda name: scenario)
        return run_blind(LAG, 2)


@pytest.mark.slow
def test_a_trial_holds_what_was_hidden_and_what_was_found(short: BlindResult) -> None:
    ((name, (lag_s,)),) = short.hidden
    assert name == 'gyro_lag' and LIBRARY_RANGES[name][0].low <= lag_s <= LIBRARY_RANGES[name][0].high
    assert short.named[0] == 'gyro_lag' and short.is_right and not short.is_excused
    assert len(short.shown) == 1 and short.shown[0] > 100.0
    assert len(short.errors_sigma) == 1 and abs(short.errors_sigma[0]) < 4.0
    drifts = [short.drift_known_deg, short.drift_before_deg, short.drift_after_deg]
    assert all(math.isfinite(drift) for drift in drifts) and short.is_costly
    assert short.drift_after_deg < short.drift_before_deg


@pytest.mark.thorough
def test_a_trial_with_images_finds_the_effect_from_tracked_features() -> None:
    scenario = replace(find_scenario('cleaning'), duration_s=40.0, imu_hz=100)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, 'find_scenario', lambda name: scenario)
        found = run_blind(LAG, 2, scene='slow')
    assert found.hidden[0][0] == 'gyro_lag' and found.named[0] == 'gyro_lag'
