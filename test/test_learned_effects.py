"""Learned effects: the functions that they are made of, and their files."""

from __future__ import annotations

import math
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contracts import GyroEffectContract, assert_derivative, eventful_block

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects import LEARNED_EFFECTS, default_model, find_effect
from gyrocal_ros.effects.learned import curve, formula, memory, place_map, step, wave
from gyrocal_ros.effects.learned.as_effect import effect_source
from gyrocal_ros.effects.learned.bump import Bump, bumps
from gyrocal_ros.effects.learned.causes import closest_effect, library_effect, meaning
from gyrocal_ros.effects.learned.curve import GRID, LENGTHS, Of, prior_stds
from gyrocal_ros.effects.learned.drives import (
    ABS_RATE,
    ANY_TURN,
    DYNAMICS,
    LAST_TURN,
    MOVING,
    SIDE,
    START,
    since_rest,
)
from gyrocal_ros.effects.learned.effect_code import Closed
from gyrocal_ros.effects.learned.forms import FORMS, Form
from gyrocal_ros.effects.learned.formula import Formula
from gyrocal_ros.effects.learned.memory import TAUS_S
from gyrocal_ros.effects.learned.memory_forms import MEMORY_FORMS, physical
from gyrocal_ros.effects.learned.place_map import PlaceMap
from gyrocal_ros.effects.learned.place_map import prior_stds as map_stds
from gyrocal_ros.effects.learned.signals import CENTRIPETAL, UNITS, values_of
from gyrocal_ros.effects.learned.wave import Sine, Wave, sine_of
from gyrocal_ros.effects.model_file import model_from_dict, model_to_dict
from gyrocal_ros.effects.registry import load_file
from gyrocal_ros.ekf.equations.predict import with_pose
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.model.bias import BiasModel
from gyrocal_ros.model.sensor import Effect, GyroEffect, Memory, SensorModel

VOLTAGE = 'battery_state.voltage'
EFFECTS: tuple[GyroEffect, ...] = (
    curve('bias', 'rate', -1.5, 1.5),
    curve('bias', 'heading'),
    curve('scale', VOLTAGE, 14.0, 16.0),
    curve('bias', 'force_y', -1.0, 1.0),
    curve('scale', CENTRIPETAL, -0.5, 0.5),
    *(memory('bias', drive) for drive in TAUS_S),
    memory('bias', VOLTAGE),
    memory('scale', START),
    memory('scale', VOLTAGE),
    memory('scale', ABS_RATE),
    step('bias', at_s=30.05),
    step('scale', at_s=30.05),
    wave('bias', period_s=7.0),
    wave('scale', period_s=7.0),
    place_map(low_m=(-1.0, -1.0), high_m=(1.0, 1.0)),
    formula('bias_curve:rate', 'dead band', 0.7),
    formula('bias_curve:heading', 'sine of the heading'),
    formula(f'scale_curve:{VOLTAGE}', 'sine', 0.2),
    formula('bias_memory:rate', 'first-order lag', 5.0),
    formula(f'bias_memory:{VOLTAGE}', 'second-order lag', 5.0),
    formula('bias_memory:abs_rate', 'passing', 5.0),
    formula('bias_memory:turn_side', 'at once'),
    formula('bias_memory:last_turn', 'fading exponential', 5.0),
    formula('bias_memory:any_turn', 'fading exponential', 5.0),
    formula('bias_memory:last_rest', 'fading exponential', 5.0),
    formula('bias_memory:dynamics', 'second-order lag'),
    formula('scale_memory:start', 'fading hyperbola', 60.0),
    Bump().at((0.2, -0.1, 0.6)),
    sine_of('bias_wave:time', 7.0),
    sine_of('scale_wave:time', 7.0),
)
each_effect = pytest.mark.parametrize(
    'effect', EFFECTS, ids=lambda effect: ' '.join([effect.name, getattr(effect, 'form', '')]).strip()
)


def posed_block(count: int = 12, seed: int = 0, start_s: float = 30.0) -> MotionBlock:
    block = eventful_block(count, seed, start_s)
    rng = np.random.default_rng(seed)
    return replace(
        block, heading_rad=rng.uniform(-8.0, 8.0, count), position_m=rng.uniform(-1.0, 1.0, (count, 2))
    )


def contribution(effect: GyroEffect, blocks: list[MotionBlock], values: Array) -> tuple[Array, Array]:
    """Return the contribution (N,) over consecutive blocks, and its derivative (N, k)."""
    kept: Memory = None
    rates, columns = [], []
    for block in blocks:
        term = effect.contribute(block, values, kept)
        kept = term.memory
        rates.append(term.rate_rad_s)
        columns.append(term.by_values)
    return np.concatenate(rates), np.concatenate(columns)


class TestEachLearnedEffect:
    @each_effect
    def test_its_name_finds_an_effect_of_its_kind(self, effect: GyroEffect) -> None:
        found = find_effect(effect.name)
        kinds = {Formula: type(getattr(effect, 'learned', None)), Bump: PlaceMap, Sine: Wave}
        assert isinstance(found, kinds.get(type(effect), type(effect))) and found.name == effect.name
        assert effect.name.partition(':')[0] in LEARNED_EFFECTS

    @each_effect
    def test_a_model_file_reproduces_it(self, effect: Effect) -> None:
        items = tuple(replace(item, prior_std=0.5 * item.prior_std) for item in effect.coefficients)
        changed = replace(effect, coefficients=items)  # type: ignore[type-var]
        model = SensorModel('learned', BiasModel(), (find_effect('scale_factor'), changed))
        assert model_from_dict(model_to_dict(model), 'model.yaml') == model

    @each_effect
    def test_derivative(self, effect: GyroEffect) -> None:
        blocks = [posed_block(), posed_block(12, 1, 30.06)]
        assert_derivative(
            effect,
            lambda values: contribution(effect, blocks, values)[0],
            lambda values: contribution(effect, blocks, values)[1],
        )

    @each_effect
    def test_it_is_passed_to_another_process(self, effect: GyroEffect) -> None:
        _, columns = contribution(effect, [posed_block()], np.zeros(len(effect.coefficients)))
        passed = pickle.loads(pickle.dumps(effect))
        assert passed == effect
        again = contribution(passed, [posed_block()], np.zeros(len(effect.coefficients)))[1]
        np.testing.assert_array_equal(again, columns)

    @each_effect
    def test_it_moves_something(self, effect: GyroEffect) -> None:
        _, columns = contribution(effect, [posed_block()], np.zeros(len(effect.coefficients)))
        assert np.all(np.abs(columns).max(axis=0) > 0.0) and np.all(np.isfinite(columns))

    @each_effect
    def test_the_cut_into_blocks_does_not_matter(self, effect: GyroEffect) -> None:
        """Signals that are averaged over a block are the exception, by their definition."""
        if effect.name.endswith(('force_y',)):
            return
        whole, values = posed_block(20), np.zeros(len(effect.coefficients))
        parts = [whole.part(slice(0, 7)), whole.part(slice(7, 20))]
        np.testing.assert_allclose(
            contribution(effect, parts, values)[1],
            contribution(effect, [whole], values)[1],
            rtol=1e-9,
            atol=1e-12,
        )

    @each_effect
    def test_without_the_signal_it_does_nothing(self, effect: GyroEffect) -> None:
        bare = replace(posed_block(), covariates={}, heading_rad=None, position_m=None)
        _, columns = contribution(effect, [bare], np.zeros(len(effect.coefficients)))
        assert np.all(np.isfinite(columns))
        if effect.name.endswith((VOLTAGE, 'heading', 'place')):
            assert not columns.any()


class TestCurve:
    def test_it_leaves_constant_and_slope_to_bias_and_scale_factor(self) -> None:
        x = np.linspace(-1.5, 1.5, GRID)
        over_rate = curve('bias', 'rate', -1.5, 1.5).basis(x)
        over_force = curve('bias', 'force_y', -1.5, 1.5).basis(x)
        np.testing.assert_allclose(over_rate.mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(over_rate.T @ x / len(x), 0.0, atol=1e-12)
        np.testing.assert_allclose(over_force.mean(axis=0), 0.0, atol=1e-12)
        assert np.abs(over_force.T @ x / len(x)).max() > 0.1, 'a slope over the acceleration is an effect'

    def test_a_heading_is_periodic(self) -> None:
        x = np.linspace(-3.0, 3.0, 50)
        block = posed_block(50)
        around = curve('bias', 'heading')
        first, second = (
            around.columns(replace(block, heading_rad=x + turns * 2.0 * math.pi)) for turns in (0, 3)
        )
        np.testing.assert_allclose(first, second, atol=1e-9)

    def test_outside_of_its_range_it_keeps_its_value_with_noise(self) -> None:
        over = curve('bias', VOLTAGE, 15.0, 15.5)
        block = replace(posed_block(4), covariates={VOLTAGE: np.array([15.2, 15.5, 15.6, 18.0])})
        term = over.contribute(block, np.ones(len(over.coefficients)), None)
        assert term.rate_rad_s[1] == term.rate_rad_s[2] == term.rate_rad_s[3]
        assert term.noise_rad_s is not None
        assert term.noise_rad_s[0] == term.noise_rad_s[1] == 0.0 < term.noise_rad_s[2] < term.noise_rad_s[3]
        spread = math.sqrt(0.5 * sum(item.prior_std**2 for item in over.coefficients))
        assert term.noise_rad_s[3] == pytest.approx(spread, rel=1e-3)

    @pytest.mark.parametrize('length', LENGTHS)
    @pytest.mark.parametrize('signal', ['rate', 'heading', 'force_y'])
    def test_the_prior_has_the_requested_spread(self, signal: str, length: float) -> None:
        stds = prior_stds(signal, 0.3, length)
        assert math.sqrt(0.5 * np.sum(stds**2)) == pytest.approx(0.3)
        assert np.all(stds > 0.0) and np.all(np.diff(stds[: len(stds) // 2]) < 0.0)

    def test_a_shorter_length_allows_faster_changes(self) -> None:
        short, long = (prior_stds('rate', 1.0, length) for length in (0.1, 0.4))
        assert short[-1] > 1e3 * long[-1]


def test_a_map_has_the_requested_spread() -> None:
    over = place_map(low_m=(0.0, 0.0), high_m=(4.0, 3.0))
    rng = np.random.default_rng(0)
    waves = over.basis(rng.uniform([0.0, 0.0], [4.0, 3.0], (20_000, 2)))
    spread = np.sqrt((np.square(waves) @ np.square(map_stds(0.3, 0.2))).mean())
    assert spread == pytest.approx(0.3, rel=0.02)
    np.testing.assert_allclose(waves.mean(axis=0), 0.0, atol=0.03)


class TestMemory:
    @pytest.mark.parametrize(('drive', 'turning'), [(LAST_TURN, -1.0), (ANY_TURN, 1.0)])
    def test_it_fades_with_its_time_constants(self, drive: str, turning: float) -> None:
        """After a turn of one second to the right, its side decays exponentially, or that of any turn."""
        bank = memory('bias', drive)
        dt_s = np.full(400, 0.01)
        rate = np.where(np.arange(400) < 100, -1.0, 0.0)
        block = replace(posed_block(400), dt_s=dt_s, rate_rad_s=np.stack([0 * rate, 0 * rate, rate], axis=1))
        columns = bank.contribute(block, np.zeros(len(bank.tau_s)), None).by_values
        assert np.all(columns[:100] == turning)
        np.testing.assert_allclose(columns[-1], turning * np.exp(-3.0 / bank.tau_s), rtol=1e-9)

    def test_that_of_a_signal_shows_its_rate_of_change(self) -> None:
        """As of a bias that follows the flow of heat; a temperature settles within some ten seconds."""
        dt_s = np.full(2500, 0.1)
        time_s, temperature_c, change = np.cumsum(dt_s), np.zeros(2500), np.zeros(2500)
        steps = (25.0, 6.0, 12.0), (62.0, -5.0, 25.0), (110.0, 7.0, 18.0), (180.0, 6.0, 10.0)
        for start_s, step_c, tau_s in steps:
            left = np.where(time_s > start_s, np.exp(-np.maximum(time_s - start_s, 0.0) / tau_s), 1.0)
            temperature_c += step_c * (1.0 - left)
            change += step_c / tau_s * np.where(time_s > start_s, left, 0.0)
        block = replace(posed_block(2500), dt_s=dt_s, temperature_c=temperature_c)
        columns, _ = memory('bias', 'temperature').remembered(block, None)
        _, squares, *_ = np.linalg.lstsq(columns, change, rcond=None)
        assert squares.item() < 0.15 * float(change @ change)

    def test_fast_changes_vanish_in_a_steady_turn(self) -> None:
        bank = memory('bias', DYNAMICS)
        count = 400
        rate = np.ones(count)
        block = replace(
            posed_block(count),
            dt_s=np.full(count, 0.01),
            rate_rad_s=np.stack([0 * rate, 0 * rate, rate], axis=1),
        )
        columns = bank.contribute(block, np.zeros(6), None).by_values
        assert np.abs(columns[0]).max() > 0.4 and np.abs(columns[-1]).max() < 1e-10

    def test_a_scale_cannot_remember_the_rate(self) -> None:
        with pytest.raises(ConfigError, match='cannot follow'):
            memory('scale', 'rate')


def test_a_step_begins_at_its_moment() -> None:
    block = posed_block()
    after = step('bias', at_s=float(block.time_s[5])).columns(block)[:, 0]
    assert after.tolist() == [0.0] * 5 + [1.0] * 7
    assert find_effect('scale_step:time').coefficients[0].unit == '1'


def test_a_parabola_is_about_the_middle_of_a_range_without_zero() -> None:
    """Far from zero its terms look alike, and like a constant; the place is not estimated."""
    form = next(item for item in FORMS if item.name == 'parabola')
    assert form.values(15.0, 17.0).tolist() == [16.0] and form.values(-1.0, 3.0).tolist() == [0.0]
    assert form.size == 2
    x = np.linspace(15.0, 17.0, 9)
    centred, plain = (np.column_stack([np.ones(9), form.columns(x, p)]) for p in (16.0, 0.0))
    assert np.linalg.cond(centred) < 10.0 < 1e4 < np.linalg.cond(plain)
    effect = formula('scale_curve:battery_state.voltage', 'parabola', 16.0)
    assert effect.parameters == () and effect.constants == (16.0,)
    assert 'P = 16.0' in effect_source(effect, (0.01, 0.02), 'a recording')


def test_the_centripetal_acceleration_is_that_of_a_circle() -> None:
    """0.6 m/s on a circle of 0.5 m."""
    block = posed_block()
    rate = np.array([[0.0, 0.0, 1.2]])
    circle = replace(block, distance_m=0.6 * block.dt_s, rate_rad_s=np.repeat(rate, 12, axis=0))
    np.testing.assert_allclose(values_of(CENTRIPETAL, circle), 0.6**2 / 0.5)


def test_every_signal_of_a_block_has_a_unit() -> None:
    block = posed_block()
    for name in UNITS:
        assert values_of(name, block).shape == (12,), name
    assert np.isnan(values_of('not.recorded', block)).all()


def test_a_block_takes_the_pose_of_the_filter() -> None:
    state = initial_state(default_model(), Config(), None, 0)
    mean = state.mean.copy()
    mean[:2], mean[5] = (1.0, 2.0), 0.5 * math.pi
    block = replace(
        eventful_block(10), rate_rad_s=np.zeros((10, 3)), distance_m=np.full(10, 0.1), dt_s=np.full(10, 0.1)
    )
    posed = with_pose(block, replace(state, mean=mean))
    assert posed.heading_rad is not None and posed.position_m is not None
    np.testing.assert_allclose(posed.heading_rad, 0.5 * math.pi)
    np.testing.assert_allclose(posed.position_m[[0, -1]], [[1.0, 2.05], [1.0, 2.95]], atol=1e-12)


def written(effect: Closed, folder: Path) -> GyroEffect:
    """Return the effect of a closed form from its file, which passes every check of a user's effect."""
    path = folder / f'{re.sub("[^a-z]", "_", effect.name)}_effect.py'
    values = [0.02, 0.001] if effect.name.endswith('dynamics') else [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    values = values[: len(effect.coefficients)]
    path.write_text(effect_source(effect, values, 'a bag'), encoding='utf-8')
    assert len(path.read_text(encoding='utf-8').splitlines()[0]) < 110
    (made,) = load_file(path)
    return made  # type: ignore[return-value]


@pytest.mark.usefixtures('library')
@pytest.mark.parametrize('form', FORMS, ids=lambda form: form.name)
def test_a_closed_form_becomes_an_effect(form: Form, tmp_path: Path) -> None:
    follows = 'heading' if form.over == 'heading' else 'force_x'
    in_model = formula(f'scale_curve:{follows}', form.name, 0.7)
    made = written(in_model, tmp_path)
    block = posed_block()
    x = values_of(follows, block)
    if form.over == 'heading':
        assert block.heading_rad is not None
        x = block.heading_rad
    expected = form.columns(x, 0.7) * block.rate_rad_s[:, 2:]
    term = made.contribute(block, np.ones(len(form.terms)), None)
    np.testing.assert_allclose(term.by_values, expected, rtol=1e-9, atol=1e-12)
    term = in_model.contribute(block, np.ones(len(form.terms)), None)
    np.testing.assert_allclose(term.by_values, expected, rtol=1e-9, atol=1e-12)


SLOW_RAD_S = 1.5
DRIVES: dict[str, tuple[tuple[Of, str], ...]] = {
    'response': (
        ('bias', 'rate'),
        ('bias', ABS_RATE),
        ('bias', MOVING),
        ('scale', ABS_RATE),
        ('scale', VOLTAGE),
        ('bias', SIDE),
        ('bias', 'temperature'),
        ('bias', VOLTAGE),
    ),
    'fading': (('bias', LAST_TURN), ('bias', ANY_TURN), ('bias', START), ('scale', START)),
    'dynamics': (('bias', DYNAMICS),),
}
MEMORIES = [
    (of, follows, form)
    for form in MEMORY_FORMS
    for of, follows in DRIVES[form.over]
    if form.suits(follows, 0.0, 1.0)
]


@pytest.mark.usefixtures('library')
@pytest.mark.parametrize(
    ('of', 'follows', 'form'), MEMORIES, ids=[f'{of}-{f}-{form.name}' for of, f, form in MEMORIES]
)
class TestWrittenMemory(GyroEffectContract):
    """The effect that is written of a closed form of a memory."""

    @pytest.fixture
    def effect(self, of: Of, follows: str, form: Form, tmp_path: Path) -> GyroEffect:
        return written(formula(f'{of}_memory:{follows}', form.name, 2.5), tmp_path)

    def test_it_is_what_the_model_has(self, effect: GyroEffect, of: Of, follows: str, form: Form) -> None:
        assert_alike(effect, formula(f'{of}_memory:{follows}', form.name, 2.5))

    def test_it_responds_as_the_form(self, effect: GyroEffect, of: Of, follows: str, form: Form) -> None:
        """To a step of the drive, after a turn or the start, or in turns to and fro."""
        count, dt_s = 4000, 0.005
        time_s = dt_s * (np.arange(count) + 0.5)
        rate = np.ones(count)
        if follows in (LAST_TURN, ANY_TURN):
            rate[1:] = 0.0
        if follows == DYNAMICS:
            rate = np.sin(SLOW_RAD_S * time_s)
        stepped = np.where(np.arange(count) < 1, 20.0, 21.0)
        block = replace(
            eventful_block(count),
            time_s=time_s,
            dt_s=np.full(count, dt_s),
            rate_rad_s=np.stack([0.0 * rate, 0.0 * rate, rate], axis=1),
            temperature_c=stepped,
            covariates={VOLTAGE: stepped},
        )
        found = effect.contribute(block, np.ones(len(form.terms)), None).by_values
        expected = form.columns(time_s, 2.5)
        if follows == DYNAMICS:
            slopes = SLOW_RAD_S * np.cos(SLOW_RAD_S * time_s), -(SLOW_RAD_S**2) * rate
            expected = np.stack(slopes, axis=1)
            expected = expected[:, : len(form.terms)]
        late = slice(60 if follows == DYNAMICS else 2, None)
        size = np.abs(expected).max(axis=0)
        np.testing.assert_allclose(found[late] / size, expected[late] / size, atol=0.01)


@pytest.mark.parametrize(
    ('name', 'form', 'remedy'),
    [
        ('bias_curve:rate', 'cubic', "did you mean 'cube'"),
        ('bias_memory:rate', 'cube', 'first-order lag'),
        ('bias_map:place', 'cube', 'leave out `form`'),
        ('bias_step:time', 'step', 'leave out `form`'),
    ],
)
def test_a_form_that_the_effect_does_not_have(name: str, form: str, remedy: str) -> None:
    tree = {'effects': ['scale_factor', {'name': name, 'form': form}]}
    with pytest.raises(ConfigError, match=remedy) as raised:
        model_from_dict(tree, 'model.yaml')
    assert 'model.yaml' in str(raised.value) and '(' not in str(raised.value).partition(':')[0]


def test_a_bump_falls_to_three_fifths_at_its_width() -> None:
    at = np.array([[1.0, 2.0], [1.3, 2.0], [1.0, 1.7], [9.0, 9.0]])
    found = bumps(at, np.array([[1.0, 2.0, 0.3]]))[:, 0]
    np.testing.assert_allclose(found, [1.0, math.exp(-0.5), math.exp(-0.5), 0.0], atol=1e-12)


def test_the_dynamics_do_not_depend_on_the_rate_of_the_imu() -> None:
    """Coefficients that nearly cancel would otherwise mean something else on another robot."""
    bank = memory('bias', DYNAMICS)
    often, seldom = (np.arange(0.0, 0.6, dt_s) for dt_s in (0.0025, 0.01))
    size = np.abs(bank.basis(often)).max(axis=0)
    difference = (bank.basis(often)[::4] - bank.basis(seldom)) / size
    assert np.abs(difference).max() < 0.02


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        (
            (0.02 * 0.3 / math.pi * 10.0, (0.2 / (2.0 * math.pi)) ** 2),
            'resonance with a period of 0.2 s, damping 0.3',
        ),
        ((0.05, 0.0006), 'pair of lags of 0.03 s and 0.02 s'),
        ((0.05, -0.0006), 'form that no oscillator has'),
    ],
)
def test_parameters_of_a_second_order_lag_in_words(values: tuple[float, float], words: str) -> None:
    first, second = (form for form in MEMORY_FORMS if form.over == 'dynamics')
    assert physical(second, values) == words
    assert physical(first, values[:1]).startswith('lag of')


def test_a_saturation_of_the_rate_is_the_dead_band_beside_the_scale_factor() -> None:
    saturation, band = (
        next(form for form in FORMS if form.name == name) for name in ('saturation', 'dead band')
    )
    x = np.linspace(-2.0, 2.0, 9)
    np.testing.assert_allclose(saturation.columns(x, 0.7), x[:, None] - band.columns(x, 0.7))
    assert saturation.suits('force_x', -1.0, 1.0) and not saturation.suits('rate', -1.0, 1.0)
    assert 'saturation' in meaning('rate', 'dead band') and 'saturation' not in meaning(
        'force_x', 'dead band'
    )


def test_forms_of_the_library_are_named() -> None:
    assert library_effect('bias', 'rate', 'cube') == 'scale_cubic'
    assert library_effect('scale', VOLTAGE, 'line') == f'covariate_scale:{VOLTAGE}'
    assert library_effect('bias', 'heading', 'sine of the heading') == ''
    assert library_effect('bias', SIDE, 'first-order lag') == 'turn_hysteresis'
    assert library_effect('bias', DYNAMICS, 'first-order lag') == 'gyro_lag'
    assert library_effect('bias', START, 'fading exponential') == 'bias_warmup'
    assert library_effect('bias', ABS_RATE, 'first-order lag') == '', (
        'nothing of the library is heated by turns'
    )
    assert library_effect('bias', VOLTAGE, 'at once') == closest_effect('bias', VOLTAGE)
    for of in ('bias', 'scale'):
        for signal in (*UNITS, *TAUS_S):
            for form in (*FORMS, *MEMORY_FORMS):
                name = library_effect(of, signal, form.name)
                assert not name or find_effect(name).acts_on == 'gyro'
        for drive in (*TAUS_S, VOLTAGE):
            assert find_effect(closest_effect(of, drive)).acts_on == 'gyro'


@pytest.mark.usefixtures('library')
@pytest.mark.parametrize(
    'in_model',
    [
        Bump().at((0.2, -0.1, 0.6)),
        sine_of('bias_wave:time', 7.0),
        sine_of('scale_wave:time', 7.0),
        wave('bias', period_s=7.0),
    ],
    ids=['bump', 'sine of the bias', 'sine of the scale', 'wave'],
)
class TestWrittenPlaceAndTime(GyroEffectContract):
    """The effect that is written of a bump at a place, or of what swings in time."""

    @pytest.fixture
    def effect(self, in_model: Closed, tmp_path: Path) -> GyroEffect:
        return written(in_model, tmp_path)

    def test_it_is_what_the_model_has(self, effect: GyroEffect, in_model: Closed) -> None:
        assert_alike(effect, in_model)


def assert_alike(effect: GyroEffect, in_model: GyroEffect) -> None:
    """Compare units and contributions of an effect with those of a learned one."""
    assert [item.unit for item in in_model.coefficients] == [item.unit for item in effect.coefficients]
    blocks, values = [posed_block(), posed_block(12, 1, 30.06)], np.ones(len(effect.coefficients))
    for found, expected in zip(
        contribution(effect, blocks, values), contribution(in_model, blocks, values), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


class TestSinceRest:
    @staticmethod
    def block(speeds_m_s: list[float]) -> MotionBlock:
        block = eventful_block(len(speeds_m_s))
        still = np.zeros(len(speeds_m_s))
        dt_s = np.full(len(speeds_m_s), 0.5)
        return replace(block, distance_m=0.5 * np.array(speeds_m_s), wheel_turn_rad=still, dt_s=dt_s)

    def test_the_time_counts_from_the_end_of_a_rest(self) -> None:
        drives, elapsed_s, _ = since_rest(self.block([0.3, 0.3, 0.0, 0.0, 0.3, 0.3, 0.0, 0.3]), None)
        assert drives.tolist() == [1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0], 'a short stop is no rest'
        assert elapsed_s[4:].tolist() == [0.5, 1.0, 1.5, 2.0]

    def test_the_time_begins_again_after_the_next_rest(self) -> None:
        first, _, memory = since_rest(self.block([0.0, 0.0, 0.3, 0.0]), None)
        then, elapsed_s, _ = since_rest(self.block([0.0, 0.3]), memory)
        assert first.tolist() == [0.0, 0.0, 1.0, 1.0] and then.tolist() == [0.0, 1.0]
        assert elapsed_s[1] == 0.5
