"""Contracts of all effects of the library, properties of single effects, and `model.yaml`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts import (
    SIGNAL,
    EffectContract,
    GroundEffectContract,
    GyroEffectContract,
    ImageEffectContract,
    LimitContract,
    NoiseEffectContract,
    OdometryContract,
    WheelEffectContract,
    eventful_block,
    eventful_blocks,
    half_slow_block,
)

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.covariate import CovariateBias
from gyrocal_ros.effects.model_file import load_model, model_from_dict, model_to_dict, model_to_yaml
from gyrocal_ros.effects.rate_deadband import INSIDE_STD
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.files import shipped
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.sensor import (
    CameraEffectOnOdometry,
    Effect,
    GyroEffect,
    GyroTerm,
    LimitEffect,
    Memory,
    coefficient_names,
    placed,
)

FURTHER = ('scale_power_4', 'scale_power_9', f'covariate_bias:{SIGNAL}', f'covariate_scale:{SIGNAL}')
ALL = [*EFFECTS.values(), *map(find_effect, FURTHER)]
CONTRACTS: dict[str, type[EffectContract]] = {}


def acting_on(*places: str) -> Callable[[type[EffectContract]], type[EffectContract]]:
    """Parametrise a contract over the effects that act at the given places."""
    effects = [effect for effect in ALL if effect.acts_on in places]
    mark = pytest.mark.parametrize('effect', effects, ids=lambda effect: effect.name)

    def marked(contract: type[EffectContract]) -> type[EffectContract]:
        CONTRACTS.update((effect.name, contract) for effect in effects)
        return mark(contract)

    return marked


@acting_on('gyro')
class TestEachGyroEffect(GyroEffectContract):
    pass


@acting_on('wheels')
class TestEachWheelEffect(WheelEffectContract):
    pass


@acting_on('ground')
class TestEachGroundEffect(GroundEffectContract):
    pass


@acting_on('camera', 'time', 'shutter')
class TestEachEffectOnImages(ImageEffectContract):
    pass


@acting_on('noise')
class TestEachNoise(NoiseEffectContract):
    pass


@pytest.mark.parametrize(
    'effect', [effect for effect in ALL if isinstance(effect, CameraEffectOnOdometry)], ids=lambda e: e.name
)
class TestEachEffectOnOdometry(OdometryContract):
    pass


@pytest.mark.parametrize(
    'effect', [effect for effect in ALL if isinstance(effect, LimitEffect)], ids=lambda e: e.name
)
class TestEachLimit(LimitContract):
    pass


def test_each_effect_has_its_contract() -> None:
    assert CONTRACTS.keys() == {effect.name for effect in ALL}


# --- single effects -----------------------------------------------------------------------------


def term(name: str, block: MotionBlock, *values: float, memory: Memory = None) -> GyroTerm:
    effect: GyroEffect = find_effect(name)  # type: ignore[assignment]
    return effect.contribute(block, np.array(values), memory)


def test_effects_are_stored_by_their_names() -> None:
    assert all(effect.name == name for name, effect in EFFECTS.items())


def test_powers_of_the_nominal_rate() -> None:
    block = eventful_block()
    names = {1: 'scale_factor', 2: 'scale_quadratic', 3: 'scale_cubic', 5: 'scale_power_5'}
    for power, name in names.items():
        expected = 0.5 * block.rate_rad_s[:, 2] ** power
        np.testing.assert_allclose(term(name, block, 0.5).rate_rad_s, expected)
        assert find_effect(name).coefficients[0].name == f'a{power}'
    units = [find_effect(name).coefficients[0].unit for name in names.values()]
    assert units == ['1', 's/rad', 's^2/rad^2', 's^4/rad^4']


def test_warmup_vanishes_long_after_power_on() -> None:
    for time_s, expected in ((0.0, -0.01), (300.0, -0.01 / math.e), (1e5, 0.0)):
        block = replace(eventful_block(2), time_s=np.full(2, time_s))
        assert term('bias_warmup', block, 0.01, 300.0).rate_rad_s == pytest.approx(expected)


@pytest.mark.parametrize('name', ['bias_warmup', 'turn_hysteresis'])
def test_any_time_constant_gives_finite_values(name: str) -> None:
    for time_constant in (-5.0, 0.0, 1e-9, 1e9):
        found = term(name, eventful_block(), 0.01, time_constant)
        assert np.isfinite(found.rate_rad_s).all() and np.isfinite(found.by_values).all()


def test_hysteresis_is_a_low_pass_of_the_turns() -> None:
    """After a turn of 1 rad/s for 5 s, with tau = 20 s, h is 1 - exp(-5/20); then it decays."""
    turning = replace(
        eventful_block(1000), dt_s=np.full(1000, 0.005), rate_rad_s=np.tile([0.0, 0.0, 1.0], (1000, 1))
    )
    after = replace(turning, rate_rad_s=np.zeros((1000, 3)))
    first = term('turn_hysteresis', turning, 0.1, 20.0)
    then = term('turn_hysteresis', after, 0.1, 20.0, memory=first.memory)
    at_end = 1.0 - math.exp(-5.0 / 20.0)
    assert first.rate_rad_s[-1] == pytest.approx(0.1 * at_end, rel=1e-3)
    assert then.rate_rad_s[-1] == pytest.approx(0.1 * at_end * math.exp(-5.0 / 20.0), rel=1e-3)


def test_hysteresis_does_not_depend_on_the_blocks() -> None:
    blocks = eventful_blocks()
    whole = replace(
        blocks[0],
        dt_s=np.concatenate([block.dt_s for block in blocks]),
        rate_rad_s=np.concatenate([block.rate_rad_s for block in blocks]),
    )
    memory, parts = None, []
    for block in blocks:
        found = term('turn_hysteresis', block, 0.1, 20.0, memory=memory)
        memory = found.memory
        parts.append(found.rate_rad_s)
    np.testing.assert_allclose(np.concatenate(parts), term('turn_hysteresis', whole, 0.1, 20.0).rate_rad_s)


def test_clipped_rates_are_replaced_by_those_of_the_wheels() -> None:
    block, limit = eventful_block(), 1.0
    clipped = replace(block, rate_rad_s=np.clip(block.rate_rad_s, -limit, limit))
    found = term('rate_saturation', clipped, limit)
    over = np.abs(block.rate_rad_s[:, 2]) > limit
    assert over.any() and not over.all()
    np.testing.assert_allclose(clipped.rate_rad_s[:, 2] + found.rate_rad_s, block.rate_rad_s[:, 2])
    assert found.noise_rad_s is not None
    np.testing.assert_array_equal(found.noise_rad_s > 0.0, over)


def block_that_turns(rate_rad_s: Array) -> MotionBlock:
    """Return a block with these yaw rates (12,)."""
    return replace(eventful_block(), rate_rad_s=np.stack([*np.zeros((2, 12)), rate_rad_s], axis=1))


def test_rates_in_the_dead_band_have_a_standard_deviation() -> None:
    block = replace(block_that_turns(np.repeat([0.1, 5.0], 6)), wheels_at_rest=False)
    found = term('rate_deadband', block, 0.5)
    assert found.noise_rad_s is not None and found.blind is not None
    assert found.noise_rad_s[:3] == pytest.approx(INSIDE_STD * 0.5)
    assert found.rate_rad_s[:3] == pytest.approx(-0.1)
    assert not found.noise_rad_s[6:].any() and not found.rate_rad_s[6:].any()
    np.testing.assert_array_equal(found.noise_rad_s > 0.0, found.blind)
    at_rest = term('rate_deadband', replace(block, wheels_at_rest=True), 0.5)
    assert not np.any(at_rest.noise_rad_s)
    np.testing.assert_array_equal(at_rest.rate_rad_s, found.rate_rad_s)


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_noise_of_the_readings_does_not_decide_what_is_in_the_dead_band(rate: float) -> None:
    """Noise that is added to the zeros takes single readings out of the band, and others into it."""
    readings = rate + np.tile([-0.9, 0.1, 0.8], 4)
    assert np.any(np.abs(readings) < 0.5) and np.any(np.abs(readings) > 0.5)
    found = term('rate_deadband', block_that_turns(readings), 0.5)
    np.testing.assert_array_equal(found.blind, np.full(12, rate == 0.0))


def test_where_the_sensor_sets_its_noise_to_zero_larger_readings_are_real() -> None:
    found = term('rate_deadband', block_that_turns(np.tile([0.0, 0.0, 0.6], 4)), 0.5)
    np.testing.assert_array_equal(found.blind, np.tile([True, True, False], 4))


@pytest.mark.parametrize(
    ('name', 'missing'),
    [
        ('bias_temperature', {'temperature_c': np.full(12, np.nan)}),
        ('scale_temperature', {'temperature_c': np.full(12, np.nan)}),
        (f'covariate_bias:{SIGNAL}', {'covariates': {}}),
        (f'covariate_scale:{SIGNAL}', {'covariates': {}}),
    ],
)
def test_a_missing_signal_contributes_nothing(name: str, missing: dict[str, Any]) -> None:
    found = term(name, replace(eventful_block(), **missing), 0.1)
    assert not found.rate_rad_s.any() and not found.by_values.any()


def test_covariates_are_relative_to_their_reference() -> None:
    tree = {'effects': ['scale_factor', {'name': f'covariate_bias:{SIGNAL}', 'reference': 15.0}]}
    effect = model_from_dict(tree, 'm.yaml').effects[1]
    assert isinstance(effect, CovariateBias)
    block = eventful_block()
    expected = 0.1 * (block.covariates[SIGNAL] - 15.0)
    np.testing.assert_allclose(effect.contribute(block, np.array([0.1]), None).rate_rad_s, expected)


@pytest.mark.parametrize(
    ('name', 'hint'),
    [
        ('scale_cubik', "did you mean 'scale_cubic'"),
        ('bias_warm_up', "did you mean 'bias_warmup'"),
        ('scale_power_3', 'scale_power_4'),
        ('scale_power_10', 'scale_power_4'),
        ('qqq', 'known are'),
    ],
)
def test_an_unknown_effect_is_refused_with_a_suggestion(name: str, hint: str) -> None:
    with pytest.raises(ConfigError, match=hint) as caught:
        find_effect(name, 'my_model.yaml')
    assert caught.value.where == 'my_model.yaml'


# --- model.yaml ---------------------------------------------------------------------------------


def test_the_shipped_model_is_the_default() -> None:
    assert load_model(shipped('config/model.yaml')) == default_model() == load_model(None)


def test_the_paper_model_settles() -> None:
    bias = load_model(shipped('config/model_paper.yaml')).bias
    assert (bias.form, bias.time_constant_s, bias.settled_rad_s) == ('settling', 500.0, 0.0)


def test_a_model_is_written_and_read_back(tmp_path: Path) -> None:
    tree = {
        'name': 'mine',
        'version': 7,
        'bias': {'form': 'settling', 'time_constant_s': 250.0, 'settled_deg_s': 0.5},
        'effects': [
            {'name': 'scale_factor', 'prior_mean': -0.07, 'prior_std': 0.01, 'walk': 1e-7},
            'scale_cubic',
            {'name': 'bias_warmup', 'prior_std': {'time_constant': 50.0}},
            'scale_power_5',
        ],
    }
    model = model_from_dict(tree, 'mine.yaml')
    assert model.coefficient_names == (
        'scale_factor', 'scale_cubic', 'bias_warmup.amplitude', 'bias_warmup.time_constant', 'scale_power_5'
    )  # fmt: skip
    assert [item.prior_std for item in model.coefficients][3] == 50.0
    assert model.coefficients[0].prior_mean == -0.07
    file = tmp_path / 'mine.yaml'
    file.write_text(model_to_yaml(model))
    assert load_model(file) == model


def test_a_model_without_a_name_takes_that_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / 'warm.yaml'
    file.write_text('effects: [scale_factor, bias_warmup]')
    assert load_model(file).name == 'warm'


def test_names_of_several_coefficients_contain_that_of_the_effect() -> None:
    assert coefficient_names(find_effect('scale_cubic')) == ('scale_cubic',)
    assert coefficient_names(find_effect('cross_axis')) == ('cross_axis.mx', 'cross_axis.my')


def test_corrections_of_all_effects_add_up() -> None:
    block, names = half_slow_block(), ('scale_factor', 'turn_slip', 'cross_axis', 'rate_deadband')
    effects: tuple[Effect, ...] = tuple(map(find_effect, names))
    gyro = placed(effects, 'gyro')
    values = np.array([0.1, 9.0, 0.02, -0.03, 0.5])
    assert [place for _, place in gyro] == [slice(0, 1), slice(2, 4), slice(4, 5)]
    assert [place for _, place in placed(effects, 'wheels')] == [slice(1, 2)]
    total = correct(gyro, block, values, (None,) * 3)
    wx, wy, wz = block.rate_rad_s.T
    valid, zero = ~np.asarray(term('rate_deadband', block, 0.5).blind), np.zeros(12)
    assert 0 < valid.sum() < 12
    added = 0.1 * wz + 0.02 * wx - 0.03 * wy
    np.testing.assert_allclose(total.rate_rad_s, np.where(valid, added, -wz))
    np.testing.assert_allclose(total.by_values, valid[:, None] * np.stack([wz, zero, wx, wy, zero], axis=1))
    np.testing.assert_array_equal(np.asarray(total.noise_rad_s) == 0.0, valid)
    np.testing.assert_array_equal(total.valid, valid)
    assert total.memories == (None, None, None)


@pytest.mark.parametrize(
    ('tree', 'message'),
    [
        ({}, 'lists no effects'),
        ({'effects': 'scale_factor'}, 'lists no effects'),
        ({'effects': []}, 'lists no effects'),
        ({'effects': ['scale_cubic']}, 'the first effect must be scale_factor'),
        ({'effects': ['scale_factor', 'scale_cubic', 'scale_cubic']}, 'scale_cubic is listed twice'),
        ({'effects': ['scale_factor', 'gyro_lagg']}, 'gyro_lagg'),
        ({'effects': ['scale_factor'], 'nmae': 'x'}, "did you mean 'name'"),
        ({'effects': ['scale_factor'], 'version': 'two'}, 'whole number'),
        ({'effects': [7]}, '7 is not an effect'),
        ({'effects': [{'prior_std': 0.1}]}, 'give its name'),
        ({'effects': [{'name': 'scale_factor', 'prior': 0.1}]}, "did you mean 'prior_"),
        ({'effects': [{'name': 'scale_factor', 'prior_std': -0.1}]}, 'a1 is -0.1'),
        ({'effects': [{'name': 'scale_factor', 'prior_std': 'wide'}]}, "a1 is 'wide'"),
        ({'effects': [{'name': 'scale_factor', 'prior_std': None}]}, 'a1 is None'),
        ({'effects': [{'name': 'scale_factor', 'prior_std': {'a2': 0.1}}]}, "did you mean 'a1'"),
        ({'effects': [{'name': 'scale_factor', 'prior_mean': math.nan}]}, 'a1 is nan'),
        ({'effects': ['scale_factor', {'name': 'bias_warmup', 'walk': 0.1}]}, 'several coefficients'),
        ({'effects': [{'name': 'scale_factor', 'prior_std': 1e300}]}, 'a1 is 1e.300'),
        (
            {'effects': ['scale_factor', {'name': 'bias_warmup', 'prior_mean': {'time_constant': -5.0}}]},
            'time_constant is -5.0',
        ),
        (
            {'effects': ['scale_factor', {'name': 'camera_time_offset', 'prior_mean': 1e9}]},
            'offset is 1000000000.0',
        ),
        ({'effects': ['scale_factor'], 'bias': 'drift'}, 'bias holds no settings'),
        ({'effects': ['scale_factor'], 'bias': {'form': 'drfit'}}, "did you mean 'drift'"),
        (
            {'effects': ['scale_factor'], 'bias': {'form': 'settling', 'time_constant_s': 0}},
            'time_constant_s is 0',
        ),
        ({'effects': ['scale_factor'], 'bias': {'form': 'settling', 'time_constant_s': 'long'}}, 'long'),
        ({'effects': ['scale_factor'], 'bias': {'form': 'settling', 'settled_deg_s': None}}, 'None'),
        ({'effects': ['scale_factor'], 'bias': {'form': 'settling', 'settled_deg_s': math.nan}}, 'nan'),
    ],
)
def test_an_invalid_model_is_refused(tree: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        model_from_dict(tree, 'my_model.yaml')
    assert 'my_model.yaml' in caught.value.where


@pytest.mark.parametrize('text', ['', '[scale_factor]', 'effects: [', '\x00'])
def test_an_invalid_model_file_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'model.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match='model.yaml'):
        load_model(file)


def test_a_missing_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='cannot be read'):
        load_model(tmp_path / 'none.yaml')


def test_every_effect_is_written_and_read_back() -> None:
    model = model_from_dict({'name': 'all', 'effects': list(EFFECTS)}, 'all.yaml')
    assert model_from_dict(model_to_dict(model), 'all.yaml') == model
