"""Learning of unknown laws: their ranking, the filter with them, and their closed forms."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from contracts import eventful_block
from scipy.stats import multivariate_normal

from gyrocal_ros.bench.strangers import StrangerResult, row
from gyrocal_ros.cli.learn import requested
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, ImuSample, MotionBlock, WheelSample
from gyrocal_ros.diagnose import status
from gyrocal_ros.diagnose.analysis.drift import drift_of_both_deg
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine
from gyrocal_ros.diagnose.analysis.signal_ranges import signal_ranges
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.laws import learning, rewriting
from gyrocal_ros.diagnose.laws.closed_forms import ClosedForm, LearnedCurve, closed_forms, curve_by
from gyrocal_ros.diagnose.laws.hypotheses import (
    AMPLITUDES,
    Law,
    RankedLaw,
    carried_by,
    is_ramp,
    law_names,
    laws,
    rank_laws,
)
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, summarise_laws
from gyrocal_ros.diagnose.laws.learning import Learned, is_missing_something, learn
from gyrocal_ros.diagnose.laws.rewriting import _Slopes, closed_form, size_of
from gyrocal_ros.diagnose.search.additions import Search
from gyrocal_ros.diagnose.search.improvement import improvement
from gyrocal_ros.diagnose.search.search import try_effect
from gyrocal_ros.effects import LEARNED_EFFECTS, default_model, find_effect
from gyrocal_ros.effects.learned import curve, formula, memory, wave
from gyrocal_ros.effects.learned.as_effect import effect_source
from gyrocal_ros.effects.learned.bump import Bump
from gyrocal_ros.effects.learned.curve import LENGTHS, prior_stds
from gyrocal_ros.effects.learned.drives import driven, lag, since_rest, since_turn
from gyrocal_ros.effects.learned.forms import FORMS
from gyrocal_ros.effects.learned.formula import Formula
from gyrocal_ros.effects.learned.memory_forms import MEMORY_FORMS
from gyrocal_ros.effects.learned.step import step
from gyrocal_ros.effects.learned.wave import Sine, Wave
from gyrocal_ros.effects.registry import load_file
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import InMemorySource, preload
from gyrocal_ros.report.laws import law_in_words
from gyrocal_ros.report.laws_figures import law_sections
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import DrawnEffect, draw_hidden, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.strangers import STRANGERS
from gyrocal_ros.sim.world import SimSource

VOLTAGE = 'battery_state.voltage'
DEG = math.radians(1.0)
Output = pytest.CaptureFixture[str]
Plain = tuple[InMemorySource, RecordingSummary, ExaminedModel]


def recording(
    *drawn: DrawnEffect, seconds: float = 150.0, seed: int = 1, camera_hz: int = 3
) -> InMemorySource:
    return simulated('cleaning', hide(drawn, find_effect), seconds, seed, camera_hz)


def simulated(
    name: str, hidden: tuple[HiddenEffect, ...], seconds: float, seed: int = 1, camera_hz: int = 3
) -> InMemorySource:
    scenario = replace(find_scenario(name), duration_s=seconds, imu_hz=100, camera_hz=camera_hz)
    source, _ = preload(SimSource(scenario, seed, hidden=hidden), Config(), default_model())
    assert isinstance(source, InMemorySource)
    return source


def runner(source: InMemorySource) -> Callable[[SensorModel, tuple[Effect, ...]], Run]:
    return lambda model, candidates: calibrate(source, Config(), model, candidates=candidates)


class TestRanking:
    def scores(self, columns: Array, measured: Array, effects: tuple[Effect, ...]) -> ScoreStatistics:
        """Score statistics of measurements with unit noise, in one block."""
        information, score = columns.T @ columns, columns.T @ measured
        return ScoreStatistics(effects, np.zeros(1), information[None], score[None])

    def test_the_gain_is_the_marginal_likelihood(self) -> None:
        rng = np.random.default_rng(0)
        effect = memory('bias', 'start')
        columns = rng.normal(size=(30, 5))
        measured = columns @ rng.normal(size=5) + rng.normal(size=30)
        law = Law(effect, effect, np.arange(5), (np.full(5, 1.0),))
        (ranked,) = rank_laws([law], self.scores(columns, measured, (effect,)))
        nothing = multivariate_normal(np.zeros(30)).logpdf(measured)
        gains = {
            float(amplitude): multivariate_normal(
                np.zeros(30), np.eye(30) + amplitude**2 * columns @ columns.T
            ).logpdf(measured)
            - nothing
            for amplitude in AMPLITUDES
        }
        best = max(gains, key=lambda amplitude: gains[amplitude])
        assert ranked.gain == pytest.approx(gains[best], rel=1e-9)
        assert [item.prior_std for item in ranked.effect.coefficients] == pytest.approx([best] * 5)

    def test_the_right_law_and_length_come_first(self) -> None:
        """Two curves of different signals: the data follow the second one, which changes slowly."""
        rng = np.random.default_rng(1)
        first, second = curve('bias', 'force_x', -1.0, 1.0), curve('bias', 'force_y', -1.0, 1.0)
        x = rng.uniform(-1.0, 1.0, (400, 2))
        columns = 1e3 * np.concatenate([first.basis(x[:, 0]), second.basis(x[:, 1])], axis=1)
        stds = prior_stds('force_y', DEG, 0.6)
        measured = columns[:, len(stds) :] @ (stds * rng.normal(size=len(stds))) + rng.normal(size=400)
        shapes = tuple(prior_stds('force_y', 0.1 * DEG, length) for length in (0.08, 0.6))
        tried = [Law(effect, effect, np.arange(8), shapes) for effect in (first, second)]
        ranked = rank_laws(tried, self.scores(columns, measured, (first, second)))
        assert ranked[0].effect.name == 'bias_curve:force_y' and ranked[0].gain > 100.0
        assert ranked[1].gain < 0.05 * ranked[0].gain
        found = np.array([item.prior_std for item in ranked[0].effect.coefficients])
        assert found[-1] < 1e-6 * found[0], 'the longer length'

    def test_noise_gains_nothing(self) -> None:
        rng = np.random.default_rng(2)
        effect = curve('bias', 'force_x', -1.0, 1.0)
        columns = 1e3 * effect.basis(rng.uniform(-1.0, 1.0, 400))
        law = Law(effect, effect, np.arange(8), (prior_stds('force_x', 0.1 * DEG, 0.3),))
        (ranked,) = rank_laws([law], self.scores(columns, rng.normal(size=400), (effect,)))
        assert ranked.gain < 3.0

    def test_laws_in_the_model_and_unwanted_ones_are_left_out(self) -> None:
        source = recording(seconds=40.0)
        ranges = signal_ranges(source)
        run = calibrate(source, Config(), default_model())
        of_motion = {'rate', 'force_x', 'yaw_acceleration', 'centripetal_acceleration'}
        assert {*of_motion, 'battery_state.voltage'} <= ranges.keys()
        assert all(low < high for low, high in ranges.values())
        names = {law.effect.name for law in laws(run, ranges)}
        assert {'bias_curve:rate', 'bias_curve:heading', 'bias_map:place', 'scale_step:time'} <= names
        assert 'scale_curve:rate' not in names, 'that is a bias over the rate'
        assert {name.partition(':')[0] for name in names} == LEARNED_EFFECTS.keys()
        some = laws(run, ranges, ['bias_curve:rate', 'bias_map:place'])
        assert [law.effect.name for law in some] == ['bias_curve:rate', 'bias_map:place']
        steps = laws(run, ranges, ['bias_step:time'])
        assert len(steps) > 1 and len(carried_by(steps)) == 1

    def test_what_a_run_does_not_tell_drives_no_memory(self) -> None:
        """A signal that rises steadily, and events that do not happen, or of which another value has more."""
        run = calibrate(recording(seconds=40.0), Config(), default_model())
        time_s = run.history.time_s
        pump = np.where((time_s > 10.0) & (time_s < 20.0) | (time_s > 30.0), 2.0, 1.0)
        signals = np.column_stack([0.01 * time_s, pump])
        history = replace(run.history, signals=signals)
        run = replace(run, history=history, signal_names=('charge', 'pump'))
        ranges = {'charge': (0.0, 0.4), 'pump': (1.0, 2.0)}
        names = {law.effect.name for law in laws(run, ranges)}
        drives = {name.partition(':')[2] for name in names if name.startswith('scale_memory:')}
        assert drives == {'start', 'abs_rate', 'pump', 'above_1.5:pump'}

    @pytest.mark.parametrize(
        ('values', 'is_one'),
        [
            (lambda time_s: 3.0 - 0.1 * time_s, True),
            (lambda time_s: np.round(0.02 * time_s, 1), True),
            (lambda time_s: np.exp(-time_s / 40.0), False),
            (lambda time_s: np.sin(time_s), False),
            (lambda time_s: np.full(len(time_s), np.nan), False),
            (lambda time_s: np.ones(len(time_s)), False),
        ],
    )
    def test_a_straight_line_over_time_is_a_ramp(
        self, values: Callable[[Array], Array], is_one: bool
    ) -> None:
        time_s = np.arange(0.0, 60.0, 0.5)
        assert is_ramp(time_s, values(time_s)) == is_one


def test_the_range_of_the_centripetal_acceleration_is_that_of_the_curves_driven() -> None:
    """Ten seconds straight on, then ten on a circle of 0.5 m, at 0.6 m/s."""
    samples: list[Any] = [WheelSample(start_ns, 0.6, 0.0) for start_ns in range(0, 20 * 10**9, 10**8)]
    samples += [
        ImuSample(t_ns, (0.0, 0.0, 1.2 * (t_ns >= 10**10)), (0.0, 0.0, 9.8))
        for t_ns in range(0, 20 * 10**9, 10**7)
    ]
    ranges = signal_ranges(SimpleNamespace(measurements=lambda: iter(samples)))  # type: ignore[arg-type]
    assert ranges['centripetal_acceleration'] == pytest.approx((0.0, 0.72))
    without = [sample for sample in samples if isinstance(sample, ImuSample)]
    ranges = signal_ranges(SimpleNamespace(measurements=lambda: iter(without)))  # type: ignore[arg-type]
    assert 'centripetal_acceleration' not in ranges


class TestClosedForms:
    def curve_of(
        self, values: Callable[[Array], Array], signal: str, low: float, high: float, length: float = 0.0
    ) -> LearnedCurve:
        """Return a curve that was fitted to a function at many places, with noise.

        Its prior is that of a smooth curve of some length, or a wide one.
        """
        rng = np.random.default_rng(3)
        made = curve('bias', signal, low, high)
        count = len(made.coefficients)
        stds = prior_stds(signal, 1.0, length).tolist() if length else [1.0] * count
        items = tuple(replace(item, prior_std=std) for item, std in zip(made.coefficients, stds, strict=True))
        effect = replace(made, coefficients=items)
        at = rng.uniform(low, high, 4000)
        basis, noise = effect.basis(at), 0.02
        present = effect.present(at)
        clean = values(at) - present @ np.linalg.lstsq(present, values(at), rcond=None)[0]
        measured = clean + noise * rng.normal(size=len(at))
        prior = np.array(stds)
        information = (basis * prior).T @ (basis * prior) / noise**2 + np.eye(count)
        covariance = np.linalg.inv(information) * np.outer(prior, prior)
        fitted = covariance @ basis.T @ measured / noise**2
        x = np.linspace(low, high, 401)
        grid = effect.basis(x)
        std = np.sqrt(np.einsum('nk,kl,nl->n', grid, covariance, grid))
        return LearnedCurve(effect, x, grid @ fitted, std, fitted, covariance, 1.0)

    @pytest.mark.parametrize(
        ('name', 'signal', 'function'),
        [
            ('cube', 'rate', lambda x: 0.3 * x**3),
            ('square', 'rate', lambda x: 0.4 * x**2),
            ('absolute value', 'rate', lambda x: 0.5 * np.abs(x)),
            ('sine', 'rate', lambda x: 0.3 * np.sin(2.0 * np.pi * x / 1.3)),
            ('line', 'force_x', lambda x: 0.4 * x),
            ('hinge', 'force_x', lambda x: 0.5 * np.maximum(x - 0.3, 0.0)),
            ('step', 'force_x', lambda x: 0.5 * (x > 0.3)),
            ('saturation', 'force_x', lambda x: 0.5 * np.clip(x, -0.5, 0.5)),
            ('dead band', 'force_x', lambda x: 0.5 * np.sign(x) * np.maximum(np.abs(x) - 0.5, 0.0)),
            ('dead band', 'rate', lambda x: 0.5 * np.clip(x, -0.5, 0.5)),
            ('rising exponential', 'force_x', lambda x: 0.3 * np.exp(x / 0.8)),
            ('sine of the heading', 'heading', lambda x: 0.3 * np.cos(x - 1.0)),
            ('sine of twice the heading', 'heading', lambda x: 0.3 * np.sin(2.0 * x)),
        ],
    )
    def test_the_law_is_found(self, name: str, signal: str, function: Callable[[Array], Array]) -> None:
        half = math.pi if signal == 'heading' else 1.5
        found = closed_forms(self.curve_of(function, signal, -half, half), 4000)
        assert found[0].form.name == name and found[0].fits
        assert found[0].explained > 0.98

    def test_its_parameters_are_found(self) -> None:
        wave = self.curve_of(lambda x: 0.3 * np.sin(2.0 * np.pi * x / 1.3), 'rate', -1.5, 1.5)
        found = closed_forms(wave, 4000)[0]
        assert found.parameter == pytest.approx(1.3, rel=0.02)
        assert found.values[0] == pytest.approx(0.3, abs=0.02)
        assert abs(found.values[1]) < 0.02

    def test_a_prior_that_leaves_no_short_waves_does_not_change_them(self) -> None:
        """Then most coefficients are not seen at all."""
        wave = self.curve_of(lambda x: 0.3 * np.cos(x - 1.0), 'heading', -math.pi, math.pi, LENGTHS[-1])
        assert np.ptp(np.log10([item.prior_std for item in wave.effect.coefficients])) > 10.0
        found = closed_forms(wave, 4000)[0]
        assert found.form.name == 'sine of the heading' and found.fits
        assert found.explained == pytest.approx(1.0, abs=0.01)
        np.testing.assert_allclose(found.values, 0.3 * np.array([math.sin(1.0), math.cos(1.0)]), atol=0.005)

    def test_a_law_of_the_library_is_named(self) -> None:
        cube = closed_forms(self.curve_of(lambda x: 0.3 * x**3, 'rate', -1.5, 1.5), 4000)[0]
        assert cube.library == 'scale_cubic'
        assert cube.values[0] == pytest.approx(0.3, abs=4.0 * cube.stds[0])

    def test_a_smooth_curve_has_no_fast_form(self) -> None:
        """Its prior leaves the fast functions at zero, so the data say nothing about them."""
        smooth = self.curve_of(lambda x: 0.3 * np.sin(x + 0.7), 'heading', -math.pi, math.pi)
        stds = prior_stds('heading', 1.0, 0.6)
        items = tuple(
            replace(item, prior_std=std)
            for item, std in zip(smooth.effect.coefficients, stds.tolist(), strict=True)
        )
        weights = np.diag(stds**-2.0)
        covariance = np.linalg.inv(np.linalg.inv(smooth.covariance) - np.eye(12) + weights)
        values = covariance @ np.linalg.solve(smooth.covariance, smooth.values)
        effect = replace(smooth.effect, coefficients=items)
        found = closed_forms(replace(smooth, effect=effect, values=values, covariance=covariance), 4000)
        assert [item.form.name for item in found] == ['sine of the heading']
        assert found[0].explained == pytest.approx(1.0, abs=1e-3)
        expected = [0.3 * math.cos(0.7), 0.3 * math.sin(0.7)]
        assert found[0].values == pytest.approx(expected, abs=4.0 * found[0].stds.max())

    def test_a_law_without_a_form_fits_none(self) -> None:
        odd = self.curve_of(lambda x: np.sin(5.0 * x) + np.cos(9.0 * x**2), 'force_x', -1.5, 1.5)
        assert not closed_forms(odd, 4000)[0].fits


class TestClosedFormsOfMemories:
    DT_S, COUNT, NOISE = 0.02, 15_000, 0.02

    def motion(self) -> MotionBlock:
        """Return turns of random size, length and distance, rests, and a voltage that jumps now and then."""
        rng = np.random.default_rng(5)
        rate, voltage = np.zeros(self.COUNT), np.zeros(self.COUNT)
        for begin in np.cumsum(rng.integers(100, 900, 30)):
            rate[begin : begin + rng.integers(50, 150)] = rng.uniform(-1.5, 1.5)
            voltage[begin:] = rng.uniform(14.0, 16.0)
        rate = np.convolve(rate, np.hanning(26) / np.hanning(26).sum(), mode='same')
        nothing, time_s = np.zeros(self.COUNT), self.DT_S * (np.arange(self.COUNT) + 0.5)
        return replace(
            eventful_block(self.COUNT),
            time_s=time_s,
            dt_s=np.full(self.COUNT, self.DT_S),
            distance_m=0.3 * self.DT_S * (time_s % 20.0 > 3.0),
            wheel_turn_rad=nothing,
            rate_rad_s=np.stack([nothing, nothing, rate], axis=1),
            covariates={VOLTAGE: voltage},
        )

    def learned(self, drive: str, law: Callable[[MotionBlock], Array]) -> LearnedCurve:
        """Return the response of a memory that was fitted to a law of unit size, with noise."""
        bank, block = memory('bias', drive), self.motion()
        count = len(bank.coefficients)
        columns, _ = bank.remembered(block, None)
        measured = law(block) + self.NOISE * np.random.default_rng(3).normal(size=self.COUNT)
        prior = np.full(count, 10.0)
        items = tuple(replace(item, prior_std=10.0) for item in bank.coefficients)
        covariance = np.linalg.inv(columns.T @ columns / self.NOISE**2 + np.diag(prior**-2.0))
        values = covariance @ columns.T @ measured / self.NOISE**2
        effect = replace(bank, coefficients=items)
        return curve_by(effect, values, covariance, 1.0, self.COUNT * self.DT_S)

    @staticmethod
    def remembers(drive: str, orders: int, tau_s: float) -> Callable[[MotionBlock], Array]:
        def law(block: MotionBlock) -> Array:
            value, _ = driven(drive, block, None)
            for _ in range(orders):
                value, _ = lag(value, block.dt_s, tau_s, None)
            return value

        return law

    @pytest.mark.parametrize('drive', ['rate', 'abs_rate', 'turn_side', VOLTAGE])
    @pytest.mark.parametrize(('name', 'orders'), [('first-order lag', 1), ('second-order lag', 2)])
    def test_a_lag_is_found(self, drive: str, name: str, orders: int) -> None:
        found = closed_forms(self.learned(drive, self.remembers(drive, orders, 12.0)), self.COUNT)[0]
        assert found.form.name == name and found.fits
        assert found.parameter == pytest.approx(12.0, rel=0.1)
        assert found.values[0] == pytest.approx(1.0, abs=0.1)

    @pytest.mark.parametrize('drive', ['abs_rate', 'turn_side', VOLTAGE])
    def test_what_acts_at_once_is_no_memory(self, drive: str) -> None:
        found = closed_forms(self.learned(drive, self.remembers(drive, 0, 0.0)), self.COUNT)[0]
        assert found.form.name == 'at once'
        assert 0.85 < found.values[0] < 1.05, 'a memory of a second or more is late by a part of a turn'

    @pytest.mark.parametrize(
        ('name', 'fading'),
        [
            ('fading exponential', lambda x: np.exp(-x / 9.0)),
            ('fading hyperbola', lambda x: 1.0 / (1.0 + x / 9.0)),
            ('fading of the second order', lambda x: (1.0 + x / 9.0) * np.exp(-x / 9.0)),
        ],
    )
    @pytest.mark.parametrize('drive', ['last_turn', 'any_turn'])
    def test_how_it_fades_after_a_turn_is_found(
        self, name: str, fading: Callable[[Array], Array], drive: str
    ) -> None:
        def law(block: MotionBlock) -> Array:
            side, since_s, _ = since_turn(block, None)
            faded: Array = (np.abs(side) if drive == 'any_turn' else side) * fading(since_s)
            return faded

        found = closed_forms(self.learned(drive, law), self.COUNT)[0]
        assert found.form.name == name and found.fits
        assert found.parameter == pytest.approx(9.0, rel=0.1)

    def test_how_it_fades_after_a_rest_is_found(self) -> None:
        def law(block: MotionBlock) -> Array:
            drives, since_s, _ = since_rest(block, None)
            faded: Array = drives * np.exp(-since_s / 6.0)
            return faded

        found = closed_forms(self.learned('last_rest', law), self.COUNT)[0]
        assert found.form.name == 'fading exponential' and found.fits
        assert found.parameter == pytest.approx(6.0, rel=0.1)

    def test_how_it_settles_after_the_start_is_found(self) -> None:
        found = closed_forms(self.learned('start', lambda block: np.exp(-block.time_s / 80.0)), self.COUNT)
        assert found[0].form.name == 'fading exponential' and found[0].library == 'bias_warmup'
        assert found[0].parameter == pytest.approx(80.0, rel=0.1)
        assert 'lasting' not in [item.form.name for item in found], 'that is the bias'

    def test_the_dynamics_are_found(self) -> None:
        """A lag has one term; a resonance of 0.25 s with damping 0.3 has two."""

        def lagging(block: MotionBlock) -> Array:
            slope: Array = 0.03 * np.gradient(block.rate_rad_s[:, 2], self.DT_S)
            return slope

        def resonant(block: MotionBlock) -> Array:
            slope = np.gradient(block.rate_rad_s[:, 2], self.DT_S)
            angular = 2.0 * math.pi / 0.25
            added: Array = 0.6 / angular * slope + np.gradient(slope, self.DT_S) / angular**2
            return added

        first = closed_forms(self.learned('dynamics', lagging), self.COUNT)[0]
        assert first.form.name == 'first-order lag' and first.library == 'gyro_lag'
        assert first.values[0] == pytest.approx(0.03, rel=0.05)
        second = closed_forms(self.learned('dynamics', resonant), self.COUNT)[0]
        assert second.form.name == 'second-order lag' and second.library == ''
        assert 2.0 * math.pi * math.sqrt(second.values[1]) == pytest.approx(0.25, rel=0.05)
        assert second.physical.startswith('resonance with a period of 0.2')

    @pytest.mark.parametrize(
        ('drive', 'x_is', 'title'),
        [
            ('abs_rate', 'since a unit step of the magnitude of the rate', 'a unit step of the magnitude'),
            (VOLTAGE, f'since a unit step of {VOLTAGE}', f'a unit step of {VOLTAGE}'),
            ('last_turn', 'since the last turn ended', 'after a turn to the left'),
            ('any_turn', 'since the last turn ended', 'after a turn'),
            ('last_rest', 'since the last rest ended', 'after a rest'),
            ('start', 'since the start', 'after the start'),
            (f'below_15.5:{VOLTAGE}', f'since a fall of {VOLTAGE} past 15.5', f'after a fall of {VOLTAGE}'),
            ('dynamics', 'w is the yaw rate', 'where a turn to 1 rad/s sets in'),
        ],
    )
    def test_words_and_figure_say_what_the_response_is(self, drive: str, x_is: str, title: str) -> None:
        curve = self.learned(drive, lambda block: block.rate_rad_s[:, 2] ** 2)
        law = LearnedLaw(curve.effect, curve, tuple(closed_forms(curve, self.COUNT)), 0.01)
        words = '\n'.join(law_in_words(law))
        assert x_is in words and f'closest in the library: {law.closest}' in words
        (section,) = law_sections([law])
        assert title in str(section.figure.layout) and law.closest in section.caption
        (summary,) = summarise_laws([law])
        assert summary['closest_library_effect'] == law.closest and len(summary['curve']['x']) == 41
        assert law.is_over_a_signal == (drive == 'start')


@pytest.fixture(scope='module')
def plain() -> Plain:
    """A recording in which nothing is hidden, and its first run."""
    source = recording()
    recorded = summarise_recording(source)
    return source, recorded, examine(default_model(), recorded, runner(source))


@pytest.mark.slow
class TestLearning:
    def test_a_bias_that_follows_the_heading_is_learned(self) -> None:
        source = recording(DrawnEffect('stranger_heading', (0.2 * DEG, 0.7)), seconds=100.0, camera_hz=4)
        recorded = summarise_recording(source)
        first = examine(default_model(), recorded, runner(source))
        assert is_missing_something(first)
        learned = learn(Search(first, ()), recorded, runner(source))
        assert learned.ranked[0].effect.name == 'bias_curve:heading'
        added, written = learned.searched.additions
        assert added.effect.name == 'bias_curve:heading' and added.sigma > 10.0
        (law,) = learned.laws
        assert law.curve is not None
        truth = 0.2 * DEG * np.sin(law.curve.x + 0.7)
        assert np.abs(law.curve.y - truth).max() < 0.03 * DEG
        assert learned.searched.kept == (written,), 'its closed form takes the place of the curve'
        found = written.after.run.state.coefficients[1:]
        expected = 0.2 * DEG * np.array([math.cos(0.7), math.sin(0.7)])
        np.testing.assert_allclose(found, expected, atol=0.01 * DEG)
        assert law.effect == written.effect and law.forms[0].form.name == 'sine of the heading'
        (summary,) = summarise_laws([law])
        assert summary['in_model_as'] == 'sine of the heading'
        assert '  in the model as: sine of the heading' in list(law_in_words(law))
        fates = [(revision.label, revision.fate) for revision in improvement(learned.searched).revisions]
        assert fates == [
            ('0_default', 'kept'),
            ('1_bias_curve_heading', 'rewritten'),
            ('2_bias_curve_heading_as_sine_of_the_heading', 'kept'),
        ]

    def test_nothing_is_learned_where_nothing_is_missing(self, plain: Plain) -> None:
        source, recorded, first = plain
        learned = learn(Search(first, ()), recorded, runner(source))
        assert learned.searched.additions == () and learned.ranked == ()

    def test_a_law_that_is_not_there_is_rejected(self, plain: Plain) -> None:
        """Also where it is requested."""
        source, recorded, first = plain
        learned = learn(Search(first, ()), recorded, runner(source), ['bias_curve:force_y'])
        assert learned.searched.kept == ()
        assert [item.effect.name for item in learned.ranked] == ['bias_curve:force_y']

    @pytest.mark.thorough
    def test_a_jump_of_the_scale_is_dated(self) -> None:
        source = recording(DrawnEffect('stranger_scale_jump', (0.02, 70.0)))
        recorded = summarise_recording(source)
        first = examine(default_model(), recorded, runner(source))
        learned = learn(Search(first, ()), recorded, runner(source))
        (added,) = learned.searched.kept[:1]
        assert added.effect.name == 'scale_step:time'
        assert abs(added.effect.at_s - 70.0) < 8.0  # type: ignore[attr-defined]
        assert added.after.run.state.coefficients[1] == pytest.approx(0.02, rel=0.05)


@pytest.mark.thorough
@pytest.mark.usefixtures('library')
def test_the_period_of_a_swing_is_refined(tmp_path: Path) -> None:
    """The spectrum of the errors tells it to some per cent; the likelihood does much better."""
    source = recording(DrawnEffect('stranger_swing', (0.2 * DEG, 31.0)), camera_hz=5)
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source), ['bias_wave:time'])
    (law,) = learned.laws
    assert isinstance(law.effect, Sine) and law.in_model_as == 'sine'
    of_wave, of_sine = (item.effect for item in learned.searched.additions[:2])
    assert isinstance(of_wave, Wave)
    assert abs(law.effect.period_s - 31.0) < min(0.03, abs(of_wave.period_s - 31.0))
    assert of_sine.name == of_wave.name == 'bias_wave:time'
    assert_replaceable(learned, recorded, source, tmp_path / 'own.py', 'law_bias_time_sine')


@pytest.mark.thorough
def test_a_bias_that_fades_after_rests_is_learned() -> None:
    fading = formula('bias_memory:last_rest', 'fading exponential', 6.0)
    source = simulated('rest_and_go', (HiddenEffect(fading, (0.35 * DEG,)),), seconds=150.0)
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source))
    (law,) = learned.laws
    assert law.effect.name == 'bias_memory:last_rest' and law.in_model_as == 'fading exponential'
    assert law.effect.parameter == pytest.approx(6.0, rel=0.1)  # type: ignore[attr-defined]
    assert learned.searched.last.run.state.coefficients[-1] == pytest.approx(0.35 * DEG, rel=0.05)


@pytest.mark.thorough
@pytest.mark.usefixtures('library')
def test_a_bias_at_a_place_is_learned_as_a_bump(tmp_path: Path) -> None:
    source = recording(DrawnEffect('stranger_place', (0.6 * DEG, 0.5)), seconds=240.0)
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source), ['bias_map:place'])
    (law,) = learned.laws
    assert law.in_model_as == 'bump' and isinstance(law.effect, Bump) and law.bump is not None
    assert law.effect.width_m == pytest.approx(0.5, rel=0.05)
    assert law.bump.height == pytest.approx(0.6 * DEG, rel=0.1)
    of_map, of_bump = (item.after for item in learned.searched.additions)
    before_deg, after_deg = drift_of_both_deg(of_map.run, of_bump.run)
    assert after_deg < 0.5 * before_deg
    assert of_bump.run.state.coefficients[1] == pytest.approx(0.6 * DEG, rel=0.02)
    (summary,) = summarise_laws([law])
    assert summary['bump']['width_m'] == law.bump.width_m and summary['in_model_as'] == 'bump'
    words = '\n'.join(law_in_words(law))
    assert 'bump of' in words and 'in the map, width 0.' in words and 'in the model as: bump' in words
    assert_replaceable(learned, recorded, source, tmp_path / 'own.py', 'law_bias_place_bump')


@pytest.mark.thorough
@pytest.mark.usefixtures('library')
def test_a_square_of_the_centripetal_acceleration_is_learned_as_such() -> None:
    source = recording(DrawnEffect('stranger_square_force', (10.0 * DEG,)))
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source))
    (law,) = learned.laws
    assert law.effect.name == 'bias_curve:centripetal_acceleration' and law.in_model_as == 'square'
    assert learned.searched.last.run.state.coefficients[-1] == pytest.approx(10.0 * DEG, rel=0.05)


@pytest.mark.slow
@pytest.mark.usefixtures('library')
def test_a_closed_form_that_predicts_worse_is_not_written_into_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = recording(DrawnEffect('stranger_heading', (0.3 * DEG, 0.7)), seconds=100.0)
    wrong = formula('bias_curve:heading', 'sine of twice the heading')
    monkeypatch.setattr(rewriting, '_closest', lambda law: (wrong, np.full(2, 0.1 * DEG), 1.0))
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source), [wrong.name])
    as_curve, as_form = learned.searched.additions
    assert as_curve.is_kept and not as_form.is_kept
    assert as_form.is_rewritten and as_form.effect.name == wrong.name and as_form.predictive_gain < -25.0
    assert learned.searched.last.model.effects[-1] == as_curve.effect
    (law,) = learned.laws
    assert law.in_model_as == ''


@pytest.mark.parametrize(
    'closed', [Bump().at((0.2, -0.1, 0.6)), formula('bias_memory:rate', 'first-order lag', 5.0), wave('bias')]
)
def test_slopes_of_a_closed_form_are_its_derivatives(closed: Bump | Formula | Wave) -> None:
    block = replace(
        eventful_block(40),
        position_m=np.random.default_rng(0).uniform(-1.0, 1.0, (40, 2)),
        heading_rad=np.zeros(40),
    )
    values = np.full(len(closed.coefficients), 0.7)
    found = (
        _Slopes(closed, tuple(values.tolist()))
        .contribute(block, np.zeros(len(closed.parameters)), None)
        .by_values
    )
    for place, parameter in enumerate(closed.parameters):
        rates = []
        for way in (-1.0, 1.0):
            moved = list(closed.parameters)
            moved[place] = parameter + way * 1e-5
            rates.append(closed.at(tuple(moved)).contribute(block, values, None).rate_rad_s)
        np.testing.assert_allclose(found[:, place], (rates[1] - rates[0]) / 2e-5, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize(
    ('gain', 'drift_sigma', 'helps'),
    [
        ([10.0] * 5, 0.0, True),
        ([200.0, 0.0, 0.0, -1.0, -1.0], 0.5, False),
        ([200.0, 0.0, 0.0, -1.0, -1.0], 3.0, True),
        ([2.0, 0.0, 0.0, -1.0, -1.0], 3.0, False),
    ],
)
def test_a_law_helps_by_its_prediction_or_by_the_drift(
    gain: list[float], drift_sigma: float, helps: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a jump that the filter follows, few stretches tell of it, but the drift does."""
    gains = np.array(gain) + 1e-3 * np.arange(5)
    monkeypatch.setattr(learning, 'predictive_gain', lambda *runs: gains)
    monkeypatch.setattr(learning, 'drift_of_both', lambda *runs: (None, None))
    monkeypatch.setattr(learning, 'better_sigma', lambda *drifts: drift_sigma)
    run = object()
    assert learning._helps(run, run) == helps  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ('coarse', 'fine', 'contending'),
    [(70.0, 110.0, ['jump', 'place']), (70.0, 80.0, ['place']), (50.0, 110.0, ['place'])],
)
def test_a_jump_is_compared_at_its_best_moment(
    coarse: float, fine: float, contending: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moments are tried some seconds apart; between them it gains far less."""
    refined: Any = {'jump': RankedLaw(SimpleNamespace(name='jump'), fine)}  # type: ignore[arg-type]
    ranked: Any = [
        RankedLaw(SimpleNamespace(name=name), gain)  # type: ignore[arg-type]
        for name, gain in [('place', 100.0), ('jump', coarse), ('heading', 65.0)]
    ]
    monkeypatch.setattr(
        learning, '_at_the_moment', lambda present, law, calibrate: refined.get(law.effect.name, law)
    )
    present: Any = None
    found = learning._contenders(present, ranked, lambda *about: pytest.fail('no run is needed'))
    assert [law.effect.name for law in found] == contending


@pytest.mark.parametrize(
    ('held_out_deg', 'sigma', 'fitted_deg', 'gain_sigma', 'drifts_more'),
    [
        (0.9, 0.2, 1.0, 0.0, False),
        (1.1, -0.5, 0.6, 3.9, False),
        (1.1, -0.5, 0.8, 3.9, True),
        (1.1, -0.5, 0.8, 4.1, False),
        (1.1, -0.5, 1.1, 4.1, True),
        (3.0, -1.5, 0.2, 4.1, True),
    ],
)
def test_a_drift_that_rises_by_chance_is_no_objection_where_the_final_one_falls(
    held_out_deg: float,
    sigma: float,
    fitted_deg: float,
    gain_sigma: float,
    drifts_more: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In a short recording the held-out spans begin before a law is known."""
    before, after = (Mock(history=Mock(coefficients=[known])) for known in ('without', 'with'))
    fitted = {'without': 1.0, 'with': fitted_deg}
    monkeypatch.setattr(
        learning, 'drift_of_both', lambda *runs: (Mock(rms_deg=1.0), Mock(rms_deg=held_out_deg))
    )
    monkeypatch.setattr(learning, 'better_sigma', lambda *drifts: sigma)
    monkeypatch.setattr(learning, 'reference_heading', lambda run: None)
    monkeypatch.setattr(learning, 'held_out_from_s', lambda run: 0.0)
    monkeypatch.setattr(learning, 'predictive_gain', lambda *runs: None)
    monkeypatch.setattr(learning, 'vuong_sigma', lambda gain, most: gain_sigma)
    monkeypatch.setattr(
        learning, 'blind_drift', lambda *about, coefficients: Mock(rms_deg=fitted[coefficients])
    )
    assert learning._drifts_more(before, after) == drifts_more


@pytest.mark.parametrize(
    ('law', 'holds'), [(wave('bias'), 'once'), (step('scale'), 'once'), (memory('bias', 'start'), '')]
)
def test_what_holds_for_one_recording_is_no_calibration_of_others(
    law: Effect, holds: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drifts = SimpleNamespace(rms_deg=1.0)
    kept = [Mock(effect=None, held_out=drifts), Mock(effect=law, held_out=drifts)]
    improved: Any = Mock(kept=kept, final=kept[1], harmful=(), fell_sigma=3.0)
    improved.final.examined.unexplained_structure = None
    improved.final.examined.run.events = ()
    monkeypatch.setattr(status, 'timing_fault', lambda examined: None)
    monkeypatch.setattr(status, 'model_fit', lambda run: SimpleNamespace(fits=True))
    said = status.improvement_status(improved)
    assert ('holds for this recording only' in said.sentence) == bool(holds)
    assert said.level == ('yellow' if holds else 'green')


# --- the command --------------------------------------------------------------------------------


RANGES = {'rate': (-1.0, 1.0), 'force_y': (-1.0, 1.0), 'temperature': (20.0, 30.0), 'fan.data': (0.0, 9.0)}


@pytest.mark.parametrize(
    ('tried', 'taken'),
    [
        ([(True, 1530.0, 8), (True, 1521.0, 1)], 1),
        ([(True, 1530.0, 8), (True, 1500.0, 1)], 0),
        ([(True, 1521.0, 1), (True, 1530.0, 1)], 1),
        ([(True, 1530.0, 8), (False, 1529.0, 1)], 0),
        ([(False, 20.0, 8), (False, 10.0, 1)], 0),
    ],
)
def test_of_laws_that_predict_as_well_the_simplest_is_learned(
    tried: list[tuple[bool, float, int]], taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ('is_kept', 'predictive_gain', 'size')
    additions = [SimpleNamespace(effect=None, **dict(zip(names, item, strict=True))) for item in tried]
    monkeypatch.setattr(learning, '_size', lambda item: item.size)
    assert learning._simplest(additions) is additions[taken]  # type: ignore[arg-type, comparison-overlap]
    assert learning._simplest([]) is None


@pytest.mark.parametrize(
    ('alone', 'found', 'gained', 'gain', 'is_better'),
    [
        ((1, 2, 1), (2, 2, 1), 1000.0, -10.0, True),
        ((1, 2, 1), (2, 2, 1), 1000.0, -50.0, False),
        ((1, 2, 1), (1, 4, 1), 1000.0, -10.0, True),
        ((1, 2, 0), (1, 2, 1), 9000.0, -50.0, True),
        ((1, 2, 0), (1, 2, 1), 9000.0, -100.0, False),
        ((1, 4, 1), (1, 2, 1), 9000.0, 10.0, False),
        ((1, 4, 1), (1, 2, 1), 1000.0, 500.0, True),
    ],
)
def test_laws_alone_replace_what_was_found_where_they_are_simpler_or_predict_better(
    alone: tuple[int, int, int],
    found: tuple[int, int, int],
    gained: float,
    gain: float,
    is_better: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first = SimpleNamespace(run='first')
    searches = [
        SimpleNamespace(kept=[1], first=first, last=SimpleNamespace(run=''), is_as=item)
        for item in (alone, found)
    ]
    monkeypatch.setattr(learning, '_complexity', lambda item: item.is_as)
    monkeypatch.setattr(learning, 'predictive_gain', lambda before, _: np.array([gained if before else gain]))
    monkeypatch.setattr(learning, '_helps', lambda *runs: gain > learning.MIN_GAIN)
    assert learning._is_better(*searches) == is_better  # type: ignore[arg-type]


def test_a_closed_form_that_misses_more_than_chance_makes_no_law_simpler() -> None:
    line = next(form for form in FORMS if form.name == 'line')
    effect = curve('bias', 'force_x', -1.0, 1.0)
    values = np.array([0.01])
    sizes = []
    for fits in (True, False):
        found = ClosedForm(line, 0.0, values, 0.1 * values, 0.99, 10.0, fits, '', '')
        law = LearnedLaw(effect, None, (found,), 0.001)
        sizes.append(size_of(law, object()))  # type: ignore[arg-type]
    assert sizes == [1, len(effect.coefficients)]


def request(**given: str) -> tuple[str, ...]:
    args = argparse.Namespace(**{'kind': None, 'follows': None, 'acts_on': None} | given)
    return requested(args, law_names(RANGES))


class TestWhatIsRequested:
    def test_nothing_in_particular(self) -> None:
        assert request() == ()

    @pytest.mark.parametrize(
        ('given', 'names'),
        [
            ({'kind': 'map'}, {'bias_map:place'}),
            ({'kind': 'step'}, {'bias_step:time', 'scale_step:time'}),
            ({'kind': 'step', 'acts_on': 'scale'}, {'scale_step:time'}),
            ({'kind': 'wave'}, {'bias_wave:time', 'scale_wave:time'}),
            ({'follows': 'heading'}, {'bias_curve:heading', 'scale_curve:heading'}),
            ({'kind': 'memory', 'follows': 'turn_side'}, {'bias_memory:turn_side'}),
            ({'kind': 'curve', 'follows': 'temperature', 'acts_on': 'scale'}, {'scale_curve:temperature'}),
            (
                {'kind': 'curve', 'follows': 'fan.data'},
                {'bias_curve:fan.data', 'scale_curve:fan.data'},
            ),
            (
                {'kind': 'memory', 'follows': 'fan.data', 'acts_on': 'scale'},
                {'scale_memory:fan.data'}
                | {
                    f'scale_memory:{side}_{value}:fan.data'
                    for side in ('above', 'below')
                    for value in (2.25, 4.5, 6.75)
                },
            ),
        ],
    )
    def test_a_part_of_what_the_recording_allows(self, given: dict[str, str], names: set[str]) -> None:
        assert set(request(**given)) == names

    @pytest.mark.parametrize(
        ('given', 'remedy'),
        [
            ({'follows': 'headng'}, "did you mean 'heading'"),
            ({'follows': 'xyzzy'}, 'known are rate, force_y'),
            ({'kind': 'map', 'follows': 'rate'}, 'known are place'),
            ({'kind': 'map', 'acts_on': 'scale'}, 'leave one of them out'),
        ],
    )
    def test_what_it_does_not_allow(self, given: dict[str, str], remedy: str) -> None:
        with pytest.raises(ConfigError, match=remedy) as raised:
            request(**given)
        assert all(value in str(raised.value) for value in given.values())


def test_every_law_is_offered_by_its_name() -> None:
    names = law_names(RANGES)
    assert len(set(names)) == len(names)
    assert all(find_effect(name).name == name for name in names)


@pytest.mark.slow
@pytest.mark.usefixtures('library', 'slow_sensors')
def test_the_command_learns_and_writes(tmp_path: Path, capsys: Output) -> None:
    bag, out, own = tmp_path / 'bag', tmp_path / 'out', tmp_path / 'own.py'
    hidden = '--effect=stranger_heading=0.005,0.7'
    assert main(['simulate', str(bag), '--duration', '120', '--seed', '3', hidden]) == 0
    capsys.readouterr()
    learn_it = ['learn', str(bag), '--follows', 'heading', '-o', str(out), '--as-effect', str(own)]
    assert main([*learn_it, '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    (law,) = printed['learned']
    assert law['effect'] == 'bias_curve:heading' and law['kind'] == 'bias_curve'
    form = law['closed_forms'][0]
    assert form['form'] == 'sine of the heading'
    assert math.hypot(*form['values']) == pytest.approx(0.005, rel=0.05), 'the amplitude that was hidden'
    assert (out / 'report.html').stat().st_size > 10_000
    assert 'bias_curve:heading' in (out / 'model.yaml').read_text(encoding='utf-8')
    drifts = [item['held_out_drift_deg']['rms'] for item in printed['revisions']]
    assert drifts[-1] < 0.5 * drifts[0]

    assert main(['replay', str(bag), '--model', str(out / 'model.yaml'), '--json']) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed['model_fits'] is not False
    assert main(['improve', str(bag), '--effects-from', str(own), '--effect', made_in(own), '--json']) == 0
    improved = json.loads(capsys.readouterr().out)
    assert improved['revisions'][-1]['kept']

    assert main(learn_it) == 2
    assert 'exists already' in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures('library')
@pytest.mark.parametrize(
    ('hidden', 'drive'),
    [
        pytest.param(
            DrawnEffect('stranger_turn_heat', (0.015, 12.0)), 'abs_rate', marks=pytest.mark.thorough
        ),
        (DrawnEffect('turn_hysteresis', (0.01, 8.0)), 'rate'),
    ],
)
def test_the_effect_of_a_memory_replaces_it(hidden: DrawnEffect, drive: str, tmp_path: Path) -> None:
    source = recording(hidden, seed=3, camera_hz=4)
    recorded = summarise_recording(source)
    first = examine(default_model(), recorded, runner(source))
    learned = learn(Search(first, ()), recorded, runner(source), [f'bias_memory:{drive}'])
    (law,) = learned.laws
    (size, tau_s), found = hidden.values, law.forms[0]
    assert law.effect.name == f'bias_memory:{drive}' and found.form.name == 'first-order lag' and found.fits
    assert found.parameter == pytest.approx(tau_s, rel=0.15)
    assert found.values.tolist() == [pytest.approx(size, rel=0.1)]
    assert law.curve is not None
    assert law.curve.y[-1] == pytest.approx(size, rel=0.15), 'the response in the end'
    assert_replaceable(learned, recorded, source, tmp_path / 'own.py', f'law_bias_{drive}')


def assert_replaceable(
    learned: Learned, recorded: RecordingSummary, source: InMemorySource, path: Path, name: str
) -> None:
    """Write the law that was learned as an effect into a file; loaded from there it is as good."""
    searched = learned.searched
    found = closed_form(learned.laws[0], searched.last)
    assert found is not None
    effect, values = found
    path.write_text(effect_source(effect, values.tolist(), 'bag'), encoding='utf-8')
    (own,) = load_file(path)
    assert own.name.startswith(name)
    tried = try_effect(searched.first.model, recorded, runner(source), own)
    assert tried.kept
    before_deg, with_own = drift_of_both_deg(tried.first.run, tried.last.run)
    with_law = drift_of_both_deg(searched.first.run, searched.last.run)[1]
    assert with_own < 1.1 * with_law and with_own < 0.5 * before_deg


def made_in(path: Path) -> str:
    """Return the name of the effect in a file."""
    line = next(line for line in path.read_text(encoding='utf-8').splitlines() if 'name: str = ' in line)
    return line.split("'")[1]


# --- the bench ----------------------------------------------------------------------------------


def test_the_rows_of_the_bench_count_what_they_say() -> None:
    good = StrangerResult('x', 0, ('bias_curve:rate',), True, 2.0, 0.2, 0.18)
    wrong = StrangerResult('x', 1, ('scale_cubic',), False, 1.0, 1.2, 0.2, names_library=True)
    rows = row('x', [good, wrong])
    assert (rows['right'], rows['good'], rows['worse'], rows['library']) == (0.5, 0.5, 0.5, 0.5)
    assert rows['before_deg'] == 1.5 and rows['learned'] == 'bias_curve:rate 1, scale_cubic 1'
    assert rows['form'] is None, 'of a law without a form'


def test_the_rows_of_the_bench_count_forms_and_scale_factors() -> None:
    """A recording on which the filter diverged has neither; the ripple's slope is in the scale factor."""
    wave = StrangerResult('stranger_ripple', 0, form='sine', scale_sigma=9.0)
    heat = StrangerResult('stranger_turn_heat', 0, form='second-order lag', scale_sigma=1.0)
    place = StrangerResult('stranger_place', 0, scale_sigma=4.0)
    diverged = StrangerResult('stranger_turn_heat', 1)
    nothing = StrangerResult('nothing hidden', 0, scale_sigma=0.5)
    rows = row('all', [wave, heat, place, diverged, nothing])
    assert (rows['form'], rows['scale_3_sigma']) == (1 / 3, 0.5)
    assert row('stranger_ripple', [wave])['scale_3_sigma'] is None


def test_a_resonance_reads_as_its_equation_says() -> None:
    """True rate and reading: `z'' / W^2 + 2 D z' / W + z = w`, without a lag by the steps."""
    dt_s, (period_s, damping) = 0.005, (0.2, 0.3)
    time_s = dt_s * np.arange(2000)
    true = np.sin(3.0 * time_s) ** 3
    read = STRANGERS['stranger_resonance'].readings(
        true, np.full(2000, dt_s), np.array([period_s, damping]), 1.0
    )
    slope, angular = np.gradient(read, dt_s), 2.0 * math.pi / period_s
    again = np.gradient(slope, dt_s) / angular**2 + 2.0 * damping * slope / angular + read
    np.testing.assert_allclose(again[200:-2], true[200:-2], atol=0.005)


def test_a_lag_that_grows_with_the_rate_reads_as_its_equation_says() -> None:
    """Its law, added to the reading, gives the true rate, in turns to both sides."""
    dt_s, scale = np.full(8000, 0.001), 0.95
    true = 1.5 * np.sin(3.0 * np.cumsum(dt_s)) ** 3
    lag = STRANGERS['stranger_growing_lag']
    read = lag.readings(true / scale, dt_s, np.array([0.02]), scale)
    block = replace(eventful_block(8000), rate_rad_s=np.stack([0.0 * read, 0.0 * read, read], 1), dt_s=dt_s)
    added = lag.contribute(block, np.array([0.02]), None).rate_rad_s
    np.testing.assert_allclose(scale * read + added, true, atol=1e-3)
    assert np.abs(scale * read - true).max() > 0.05


@pytest.mark.parametrize('name', STRANGERS)
def test_the_forms_of_strangers_exist(name: str) -> None:
    """Each is one of something that its right effects are a function of."""
    stranger = STRANGERS[name]
    over = {getattr(find_effect(effect), 'over', '') for effect in stranger.right}
    for wanted in stranger.forms:
        assert any(form.name == wanted and form.over in over for form in (*FORMS, *MEMORY_FORMS))


@pytest.mark.parametrize('name', STRANGERS)
def test_every_stranger_says_what_is_right(name: str) -> None:
    stranger = STRANGERS[name]
    assert stranger.source and all(find_effect(effect) for effect in stranger.right)
    drawn = draw_hidden(3, 300.0, [name])
    (hidden,) = hide(drawn, find_effect)
    term = hidden.effect.contribute(posed(), np.array(hidden.values), None)  # type: ignore[attr-defined]
    assert term.rate_rad_s.shape == (400,) and np.all(np.isfinite(term.rate_rad_s))
    assert np.ptp(term.rate_rad_s) > 0.01 * DEG


def posed() -> MotionBlock:
    """Return two seconds of a turn, with every signal that a stranger follows."""
    block = eventful_block(400, start_s=140.0)
    turn = np.concatenate([np.zeros(100), np.full(200, 1.2), np.zeros(100)])
    rates = np.zeros((400, 3))
    rates[:, 2] = turn
    return replace(
        block,
        time_s=np.linspace(60.0, 230.0, 400),
        rate_rad_s=rates,
        wheel_turn_rad=turn * block.dt_s,
        heading_rad=np.cumsum(turn * block.dt_s),
        position_m=np.linspace(-2.0, 2.0, 800).reshape(400, 2),
        covariates={
            'battery_state.voltage': np.linspace(14.0, 16.0, 400),
            'battery_state.current': np.linspace(0.5, 3.0, 400),
            'fan_speed.data': np.linspace(0.0, 2e4, 400),
        },
    )


def test_strangers_are_for_the_bench_blind(capsys: Output) -> None:
    assert main(['bench', 'eyes', '--strangers']) == 2
    assert '--strangers' in capsys.readouterr().err
