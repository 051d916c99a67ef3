"""Noise as an explanation: sizes that are found, and laws that are not taken for noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import ClassVar
from unittest.mock import Mock

import numpy as np
import pytest
from synthetic import readings, turning_rad_s

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, MotionBlock, Source
from gyrocal_ros.diagnose import diagnosis, noise
from gyrocal_ros.diagnose.analysis.drift import drift_of_both, drifts_more
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, with_effect
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording, white_noise
from gyrocal_ros.diagnose.diagnosis import Diagnosis, MissingEffect, diagnose
from gyrocal_ros.diagnose.noise import MIN_GAIN, MORE_DRIFT, find_missing, or_noise, shown_noise
from gyrocal_ros.diagnose.search import elimination, noise_fit
from gyrocal_ros.diagnose.search.additions import NONE, Addition, Removal, Search, addition
from gyrocal_ros.diagnose.search.elimination import eliminate, without_harm
from gyrocal_ros.diagnose.search.improvement import improvement, removal_reason
from gyrocal_ros.diagnose.search.noise_fit import NoiseFit, fit_noises, with_noise
from gyrocal_ros.diagnose.search.search import continued
from gyrocal_ros.diagnose.status import ADD_NOISE, LAW_OR_NOISE, diagnosis_status, improvement_status
from gyrocal_ros.diagnose.unknown_law import name_unknown
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.effects.learned.memory import memory
from gyrocal_ros.effects.learned.step import step
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.model.recording import GyroReadings, RecordingSummary
from gyrocal_ros.model.sensor import Coefficient, Effect, GyroTerm, Memory, Place, SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.hidden import DrawnEffect, hide
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DEG = math.radians(1.0)
Quiet = tuple[Source, RecordingSummary, ExaminedModel]
SIZES = {'gyro_noise': 0.06 * DEG, 'rate_noise': 0.003, 'bias_instability': 0.01 * DEG}


@dataclass(frozen=True)
class TwoLevels:
    """Popcorn noise: the bias jumps to and fro between two levels, at random."""

    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'two_levels'
    coefficients: tuple[Coefficient, ...] = (Coefficient('apart', 'rad/s', prior_std=0.0),)
    mean_s: float = 8.0
    """Mean time at one level."""
    seed: int = 4
    """Seed of the jumps."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return nothing: it cannot be corrected."""
        return GyroTerm(np.zeros(len(block.dt_s)), np.zeros((len(block.dt_s), 1)))

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Add the level of each moment."""
        jumps = np.random.default_rng(self.seed).random(len(dt_s)) < dt_s / self.mean_s
        read: Array = nominal_rad_s + values[0] * (np.cumsum(jumps) % 2 - 0.5)
        return read


def recording(
    name: str, *values: float, seconds: float = 100.0, seed: int = 2, also: tuple[HiddenEffect, ...] = ()
) -> Source:
    scenario = replace(find_scenario('cleaning'), duration_s=seconds, imu_hz=100, camera_hz=3)
    hidden = (*(hide((DrawnEffect(name, values),), find_effect) if name else ()), *also)
    source, _ = preload(SimSource(scenario, seed, hidden=hidden), Config(), default_model())
    return source


@pytest.fixture(scope='module')
def quiet() -> Quiet:
    """A recording in which nothing is hidden, and its first run."""
    source = recording('', seconds=60.0)
    recorded = summarise_recording(source)
    return source, recorded, examine(default_model(), recorded, runner(source))


def runner(source: Source) -> Callable[[SensorModel, tuple[Effect, ...]], Run]:
    return lambda model, tried: calibrate(source, Config(), model, candidates=tried)


def diagnosed(source: Source) -> Diagnosis:
    recorded, run = summarise_recording(source), runner(source)
    searched = find_missing(default_model(), recorded, run)
    return diagnose(name_unknown(searched, recorded, run), recorded)


@pytest.mark.parametrize('name', SIZES)
def test_the_size_of_a_noise_is_found(name: str) -> None:
    source = recording(name, SIZES[name])
    present = examine(default_model(), summarise_recording(source), runner(source))
    found = next(item for item in fit_noises(present) if item.effect.name == name)
    size = found.effect.coefficients[0].prior_mean
    assert found.gain > 25.0 and found.std < 0.3 * size
    assert abs(size - SIZES[name]) < 4.0 * found.std


def test_no_noise_is_fitted_to_a_gyro_without() -> None:
    source = recording('')
    present = examine(default_model(), summarise_recording(source), runner(source))
    fits = fit_noises(present)
    assert [item.effect.name for item in fits] and fits[0].gain < 5.0
    assert np.all(np.diff([item.gain for item in fits]) <= 0.0)


@pytest.mark.slow
def test_noise_is_a_verdict_of_its_own() -> None:
    found = diagnosed(recording('rate_noise', SIZES['rate_noise'], seconds=150.0))
    assert found.verdict == 'noise' and [item.effect.name for item in found.missing] == ['rate_noise']
    assert found.fit.fits and found.unexplained is None
    assert found.missing[0].stds[0] > 0.0
    assert 'rate_noise' in diagnosis_status(found).sentence
    law = diagnosis_status(replace(found, rival_law='the bias goes with temperature'))
    assert 'the bias goes with temperature, which explains nearly as much' in law.sentence
    assert law.next_step == LAW_OR_NOISE
    for is_advised in (True, False):
        noise = replace(found.missing[0], raises_drift=not is_advised)
        status = diagnosis_status(replace(found, missing=(noise,), rival_law=''))
        assert ('let `gyrocal improve` add it' in status.next_step) == is_advised
        assert ('the robot drifts more with it' in status.sentence) != is_advised


@pytest.mark.thorough
def test_noise_is_found_beside_an_effect_that_explains_more() -> None:
    late = hide((DrawnEffect('camera_time_offset', (0.02,)),), find_effect)
    found = diagnosed(recording('bias_instability', 0.015 * DEG, seconds=150.0, also=late))
    named = [item.effect.name for item in found.missing]
    assert named == ['camera_time_offset', 'bias_instability'], 'the one that explains more comes first'
    assert found.missing[1].values[0] == pytest.approx(0.015 * DEG, rel=0.4)


@pytest.mark.thorough
def test_a_bias_that_jumps_to_and_fro_is_noise() -> None:
    """It drifts more with the noise, for the bias is followed faster, but no more than the noise explains."""
    source = recording('', seconds=80.0, also=(HiddenEffect(TwoLevels(), (0.6 * DEG,)),))
    found = diagnosed(source)
    assert found.verdict == 'noise' and [item.effect.name for item in found.missing] == ['bias_instability']
    status = diagnosis_status(found)
    assert found.unusual_noise == ['bias_instability'] and 'a loose contact' in status.sentence
    assert 'gyrocal learn' in status.next_step


@pytest.mark.slow
@pytest.mark.parametrize(
    ('seconds', 'seed', 'walk_deg_s', 'levels_deg_s', 'is_harmful', 'rises'),
    [
        (100.0, 2, 0.0, 0.2, True, True),
        (80.0, 2, 0.0, 0.6, False, False),
        (100.0, 31, 0.02, 0.0, False, True),
    ],
)
def test_noise_with_which_the_robot_drifts_more_is_left_out(
    seconds: float, seed: int, walk_deg_s: float, levels_deg_s: float, is_harmful: bool, rises: bool
) -> None:
    """Without it, a bias that jumps far makes the filter wrong for a while after each jump.

    A bias that walks is noise, though by chance the drift may rise a little with it.
    """
    levels = HiddenEffect(TwoLevels(seed=5), (levels_deg_s * DEG,))
    source = recording('bias_instability', walk_deg_s * DEG, seconds=seconds, seed=seed, also=(levels,))
    recorded, run = summarise_recording(source), runner(source)
    first = examine(default_model(), recorded, run)
    fitted = next(item for item in fit_noises(first) if item.effect.name == 'bias_instability')
    searched = Search(first, (with_noise(first, fitted, recorded, run),))
    before, after = drift_of_both(searched.first.run, searched.last.run)
    assert searched.kept and drifts_more(before, after) == is_harmful
    assert (after.rms_deg > before.rms_deg) == rises
    found = without_harm(searched, recorded, run)
    if not is_harmful:
        assert found is searched
        return
    assert found.kept == () and found.last.model.effects == first.model.effects
    shown = improvement(found)
    assert shown.harmful == ('bias_instability',)
    assert 'the robot drifts more with it' in shown.final.why
    status = improvement_status(shown)
    assert status.level == 'yellow' and status.next_step == ADD_NOISE
    assert 'bias_instability' in status.sentence


@pytest.mark.parametrize(('after_deg', 'is_named'), [(5.2, False), (4.0, True), (math.nan, True)])
def test_what_is_found_beside_a_harmful_noise_is_named_if_the_robot_drifts_less(
    after_deg: float, is_named: bool
) -> None:
    figures = np.ones(1), np.ones(1), 50.0, 5.0, 1e-6
    walk = MissingEffect(find_effect('bias_instability'), *figures, 1.9, 4.4, (), raises_drift=True)
    cubic = MissingEffect(find_effect('scale_cubic'), *figures, 4.4, after_deg, ())
    assert list(diagnosis._not_of_noise([walk, cubic])) == [walk, cubic][: 1 + is_named]
    harmless = replace(walk, raises_drift=False)
    assert list(diagnosis._not_of_noise([harmless, cubic])) == [harmless, cubic]


@pytest.mark.parametrize(('without_deg', 'is_removed'), [(1.9, True), (2.5, False), (math.nan, False)])
def test_what_was_found_beside_a_harmful_noise_has_to_help_without_it(
    without_deg: float, is_removed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cubic term made up for what the noise got wrong; one that is there helps without the noise, too."""

    def examined(version: int) -> Mock:
        return Mock(model=Mock(version=version))

    names = ('bias_instability', 'scale_cubic')
    noise, cubic = (
        Mock(effect=find_effect(name), after=examined(version), is_rewritten=False)
        for version, name in enumerate(names, 2)
    )
    removed = [
        Removal(item.effect, Mock(), examined(version), 5.0) for version, item in enumerate((noise, cubic), 4)
    ]
    monkeypatch.setattr(elimination, 'without_addition', Mock(side_effect=removed))
    monkeypatch.setattr(elimination, 'drift_of_both', Mock(return_value=(Mock(), Mock())))
    monkeypatch.setattr(elimination, 'drifts_more', Mock(return_value=True))
    monkeypatch.setattr(elimination, 'drift_of_both_deg', Mock(return_value=(without_deg, 2.2)))
    found = without_harm(Search(examined(1), (noise, cubic)), Mock(), Mock())
    assert [item.was_beside_noise for item in found.removals] == [False, True][: 1 + is_removed]
    assert found.removals[0].is_harmful
    assert ('it was found beside a noise' in removal_reason(found.removals[-1])) == is_removed


@pytest.mark.slow
def test_noise_that_the_readings_show_is_a_verdict_though_the_filter_takes_it_over() -> None:
    density = 0.1 * DEG
    source = recording('gyro_noise', density, seconds=60.0)
    assert white_noise(summarise_recording(source).readings) == pytest.approx(density, rel=0.03)
    found = diagnosed(source)
    assert found.verdict == 'noise' and [item.effect.name for item in found.missing] == ['gyro_noise']
    assert abs(found.missing[0].values[0] - density) < 4.0 * found.missing[0].stds[0]


@pytest.mark.slow
def test_noise_that_the_readings_show_does_not_contain_what_an_effect_does_to_the_headings() -> None:
    density = 0.06 * DEG
    also = hide((DrawnEffect('scale_asymmetry', (0.03,)),), find_effect)
    source = recording('gyro_noise', density, seconds=60.0, also=also)
    recorded, run = summarise_recording(source), runner(source)
    first = examine(default_model(), recorded, run)
    fitted = next(item for item in fit_noises(first) if item.effect.name == 'gyro_noise')
    assert fitted.size > 1.5 * density, 'the effect enlarges it'
    found = shown_noise(first, recorded, run)
    assert found is not None and found.effect.coefficients[0].prior_mean == pytest.approx(density, rel=0.05)


def test_corrections_of_the_way_are_no_white_noise() -> None:
    """A robot along a wall turns a little to and fro in every reading; turns on the spot are steady."""
    density, rng = 0.005 * DEG, np.random.default_rng(4)
    t_ns = np.arange(6000) * 20_000_000
    turns = np.where(t_ns // 10**9 % 10 < 6, 60.0 * DEG, 0.0)
    corrected = np.where(turns == 0.0, 1.0 * DEG * rng.choice([-1.0, 1.0], 6000), 0.0)
    read = turns + corrected + density * math.sqrt(50.0) * rng.normal(size=6000)
    assert white_noise(GyroReadings(t_ns, read)) == pytest.approx(density, rel=0.1)


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_vibration_is_no_white_noise(seed: int) -> None:
    """That of a brush, 2 deg/s at 27 Hz, beside white noise: half of a minute straight on, half in turns."""
    rng, interval_s, density = np.random.default_rng(seed), 0.01, 0.01 * DEG
    time_s = interval_s * np.arange(6000)
    turning = 60.0 * DEG * (time_s % 10.0 > 5.0)
    read = turning + density / math.sqrt(interval_s) * rng.standard_normal(6000)
    t_ns = np.round(1e9 * time_s).astype(np.int64)
    assert white_noise(GyroReadings(t_ns, read)) == pytest.approx(density, rel=0.06)
    vibrating = read + 2.0 * DEG * np.sin(2.0 * np.pi * 27.3 * time_s)
    assert white_noise(GyroReadings(t_ns, vibrating)) < 3.0 * density


@pytest.mark.parametrize(
    ('name', 'is_white'), [('gyro_noise', True), ('rate_noise', False), ('bias_instability', False)]
)
def test_noisy_readings_prove_white_noise_alone(
    name: str, is_white: bool, quiet: Quiet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wandering bias does not make them scatter, and what grows with the rate not those of slow turns."""
    source, recorded, first = quiet
    assert shown_noise(first, recorded, runner(source)) is None, 'these readings show none'
    fitted = NoiseFit(with_means(find_effect(name), (SIZES[name],)), 1e3, 1e-6)
    monkeypatch.setattr(noise, 'white_noise', lambda readings: 0.1 * DEG)
    monkeypatch.setattr(noise, 'fit_noises', lambda *about: [fitted])
    monkeypatch.setattr(Addition, 'predictive_gain', 0.0)
    found = shown_noise(first, recorded, runner(source))
    if not is_white:
        assert found is None
        return
    assert found is not None and found.effect == fitted.effect
    assert found.is_kept, 'the filter takes it over, so it need not predict better'
    assert shown_noise(found.after, recorded, runner(source)) is None, 'the model knows it'


def noisy_readings(name: str, size: float, seed: int) -> GyroReadings:
    """Return the readings of a drive, 100 a second, with a noise and that of the settings."""
    rng, effect, rate = np.random.default_rng(seed), find_effect(name), np.repeat(turning_rad_s(100.0), 10)
    known = math.radians(Config().gyro.rate_noise_deg_s)
    density = np.hypot(known, effect.density(rate, np.array([size])))  # type: ignore[attr-defined]
    walk = effect.bias_walk(np.array([size]))  # type: ignore[attr-defined]
    bias = walk * math.sqrt(0.01) * np.cumsum(rng.normal(size=len(rate)))
    return readings(rate + bias + density / math.sqrt(0.01) * rng.normal(size=len(rate)), 100.0)


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('name', SIZES)
def test_readings_that_scatter_far_less_refute_a_noise(name: str, seed: int) -> None:
    size = 5.0 * SIZES[name]
    read = noisy_readings(name, size, seed)
    assert noise._fits_readings(NoiseFit(with_means(find_effect(name), (size,)), 1.0, 0.0), read)
    too_large = NoiseFit(with_means(find_effect(name), (10.0 * size,)), 1.0, 0.0)
    assert not noise._fits_readings(too_large, read)


def test_what_the_bias_follows_is_preferred_to_a_walk_that_no_gyro_has() -> None:
    walk = NoiseFit(with_means(find_effect('bias_instability'), (0.2 * DEG,)), 1e3, 1e-6)
    usual = NoiseFit(with_means(find_effect('bias_instability'), (0.02 * DEG,)), 1e3, 1e-6)
    law, jump = Mock(at_s=None), Mock(at_s=30.0)
    assert noise._part_of_law(law, walk) == noise.LAW_PART < 1.0 < noise._part_of_law(law, usual)
    assert noise._part_of_law(jump, walk) == noise._part_of_law(jump, usual) == noise.JUMP_PART


@pytest.mark.parametrize(
    ('gain', 'drift_sigma', 'is_kept', 'is_better'),
    [
        (0.9, 2.1, True, True),
        (0.9, 1.9, True, False),
        (0.9, 2.1, False, False),
        (1.1, 0.0, False, True),
        (1.01, 0.0, False, False),
        (1.01, 0.0, True, True),
        (0.9, 0.0, False, False),
    ],
)
def test_a_law_with_which_the_robot_drifts_clearly_less_refutes_a_noise(
    gain: float, drift_sigma: float, is_kept: bool, is_better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A walk that no gyro has predicts the next image as well: coarse steps drove 5.4 deg in place of 0.1."""
    found, rival = Mock(predictive_gain=1e3), Mock(predictive_gain=gain * 1e3, is_kept=is_kept)
    monkeypatch.setattr(noise, 'drift_of_both', lambda before, after: (before, after))
    monkeypatch.setattr(noise, 'better_sigma', lambda before, after: drift_sigma)
    assert noise._is_better(rival, found) == is_better


@pytest.mark.parametrize(('factor', 'is_better'), [(0.95, False), (1.05, True)])
def test_a_jump_that_explains_most_refutes_a_noise(
    factor: float, is_better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It explains one moment with one number, where the noise follows all else that the bias does."""
    gain = factor * noise.JUMP_PART * 1e3
    jump = Mock(effect=step('bias'), predictive_gain=gain, is_kept=True)
    monkeypatch.setattr(noise, 'drift_of_both', lambda before, after: (before, after))
    monkeypatch.setattr(noise, 'better_sigma', lambda before, after: 0.0)
    assert noise._is_better(jump, Mock(predictive_gain=1e3)) == is_better


@pytest.mark.parametrize(
    ('name', 'explained', 'by_walk', 'objects'),
    [
        ('covariate_bias:battery_state.voltage', 23.0, 17.0, True),
        ('covariate_bias:battery_state.voltage', 28.0, 17.0, False),
        ('covariate_bias:battery_state.voltage', 5.0, 0.0, False),
        ('bias_temperature', 23.0, 17.0, False),
    ],
)
def test_a_signal_has_to_explain_more_than_a_walk_of_the_bias(
    name: str, explained: float, by_walk: float, objects: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A battery runs down as steadily as most walks go."""
    walk = NoiseFit(find_effect('bias_instability'), by_walk, 0.0)
    rates = NoiseFit(find_effect('rate_noise'), 1e3, 0.0)
    monkeypatch.setattr(noise_fit, 'fit_noises', lambda present: [rates, walk])
    monkeypatch.setattr(noise_fit, 'heading_log_likelihood', lambda seen: seen)
    before, after = SimpleNamespace(seen=100.0), SimpleNamespace(seen=100.0 + explained)
    added = Addition(find_effect(name), before, after, 0.0, 0.0, 1.0, np.zeros(1), NONE)  # type: ignore[arg-type]
    assert bool(noise_fit.unless_a_walk_explains(added).objection) == objects


@pytest.mark.parametrize(
    ('effect', 'part', 'is_told'),
    [
        (memory('bias', 'temperature'), 0.9, True),
        (memory('bias', 'temperature'), 0.7, False),
        (step('bias'), 0.9, False),
        (find_effect('bias_temperature'), 0.9, False),
    ],
)
def test_a_law_that_predicts_nearly_as_well_is_told_beside_a_noise(
    effect: Effect, part: float, is_told: bool
) -> None:
    """A jump is one of many, and an effect of the library has been weighed before."""
    rival, found = Mock(effect=effect, predictive_gain=part * 1e3), Mock(predictive_gain=1e3)
    assert noise._alike([rival], found) is (rival if is_told else None)


def test_a_few_readings_refute_no_noise() -> None:
    none = readings(np.zeros(0), 100.0)
    for name, size in SIZES.items():
        assert noise._fits_readings(NoiseFit(with_means(find_effect(name), (size,)), 1.0, 0.0), none)


@pytest.mark.parametrize('name', SIZES)
@pytest.mark.parametrize('proven', [False, True])
def test_noise_in_place_of_what_was_found_has_to_be_proven(
    name: str, proven: bool, quiet: Quiet, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, recorded, first = quiet
    searched, asked = Search(first, ()), []
    fitted = NoiseFit(with_means(find_effect(name), (SIZES[name],)), 1e3, 1e-6)
    kept = replace(addition(first, first), effect=fitted.effect, gain=1e3)

    def rivals(*about: object) -> list[Addition] | None:
        asked.append(about)
        return [] if proven else None

    monkeypatch.setattr(noise, 'is_missing_something', lambda *about: True)
    monkeypatch.setattr(noise, 'fit_noises', lambda *about: [fitted])
    monkeypatch.setattr(noise, '_first_kept', lambda *about: kept)
    monkeypatch.setattr(noise, '_rivals', rivals)
    monkeypatch.setattr(noise, '_fits_readings', lambda *about: True)
    monkeypatch.setattr(noise, 'continued', lambda additions, *about: additions)
    monkeypatch.setattr(Addition, 'predictive_gain', 1e3)
    found = or_noise(searched, recorded, runner(source), most=1)
    assert asked
    monkeypatch.setattr(noise, '_fits_readings', lambda *about: False)
    assert or_noise(searched, recorded, runner(source), most=1) is searched
    assert [item.effect.name for item in found.additions] == ([name] if proven else [])


@pytest.mark.parametrize(
    ('gain', 'more_drift', 'at_fault', 'named'),
    [
        (2.0 * MIN_GAIN, 1.0, False, ['gyro_lag', 'rate_noise']),
        (0.5 * MIN_GAIN, 0.9 * MORE_DRIFT, False, ['bias_instability']),
        (0.5 * MIN_GAIN, 1.1 * MORE_DRIFT, False, ['gyro_lag', 'rate_noise']),
        (0.5 * MIN_GAIN, 1.0, True, ['gyro_lag']),
    ],
)
def test_noise_beside_what_was_found_and_noise_in_its_place(
    gain: float,
    more_drift: float,
    at_fault: bool,
    named: list[str],
    quiet: Quiet,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The one that predicts better is returned, unless the robot drifts far less with what was found.

    Neither is returned where the stamps are at fault.
    """
    source, recorded, first = quiet
    run = runner(source)

    def added(before: ExaminedModel, name: str) -> Addition:
        item = addition(before, replace(before, model=with_effect(before.model, find_effect(name))))
        vars(item)['is_kept'] = True
        return item

    lag = added(first, 'gyro_lag')

    def with_noise_for(searched: Search, *about: object) -> Search:
        name = 'bias_instability' if searched.first is first else 'rate_noise'
        return Search(searched.first, (added(searched.first, name),))

    def gained(before: Run, after: Run) -> Array:
        return np.array([gain])

    monkeypatch.setattr(noise, 'first_run', lambda *about: (first, []))
    monkeypatch.setattr(noise, 'search_from', lambda *about: Search(first, (lag,)))
    monkeypatch.setattr(noise, 'or_noise', with_noise_for)
    monkeypatch.setattr(noise, 'eliminate', lambda searched, *about: searched)
    monkeypatch.setattr(noise, 'predictive_gain', gained)
    monkeypatch.setattr(noise, 'drift_of_both_deg', lambda before, after: (more_drift, 1.0))
    monkeypatch.setattr(noise, 'timing_fault', lambda examined: 'jitter' if at_fault else None)
    found = find_missing(default_model(), recorded, run)
    assert [item.effect.name for item in found.kept] == named


@pytest.mark.thorough
def test_an_unknown_law_is_not_taken_for_noise() -> None:
    found = diagnosed(recording('stranger_heading', 0.3 * DEG, 0.7, seconds=80.0))
    assert found.verdict in ('unexplained', 'cannot_tell')
    assert not any(item.effect.acts_on == 'noise' for item in found.missing)


@pytest.mark.slow
@pytest.mark.parametrize('is_noisy', [False, True])
def test_a_noise_that_stood_for_an_effect_becomes_smaller_or_goes_once_it_is_found(is_noisy: bool) -> None:
    size = SIZES['bias_instability']
    also = hide((DrawnEffect('scale_asymmetry', (0.03,)),), find_effect)
    source = recording('bias_instability' if is_noisy else '', *([size] if is_noisy else []), also=also)
    recorded, run = summarise_recording(source), runner(source)
    first = examine(default_model(), recorded, run)
    fitted = next(item for item in fit_noises(first) if item.effect.name == 'bias_instability')
    assert fitted.size > 3.0 * size, 'it stands for the effect'
    added = with_noise(first, fitted, recorded, run)
    before = Search(first, tuple(continued([added], added.after, recorded, run, 2)))
    assert [item.effect.name for item in before.kept] == ['bias_instability', 'scale_asymmetry']
    found = eliminate(before, recorded, run)
    assert [item.effect.name for item in found.removals] == ['bias_instability']
    assert [item.effect.name for item in found.kept] == ['scale_asymmetry', *['bias_instability'] * is_noisy]
    assert found.last.model.effects[-1].name == found.kept[-1].effect.name
    shown = improvement(found)
    assert shown.final.examined is found.last
    if is_noisy:
        again = found.kept[-1]
        assert abs(again.effect.coefficients[0].prior_mean - size) < 4.0 * again.stds[0]
        assert 'is added again' in shown.kept[-2].why
