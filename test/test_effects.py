"""Every effect of the library against its contract, and `model.yaml`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts import (
    CameraEffectContract,
    EffectContract,
    GyroEffectContract,
    MotionEffectContract,
    eventful_block,
)

from gyrocal_ros.data import MotionBlock
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.bias_warmup import BiasWarmup
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.effects.model_file import load_model, model_from_dict, model_to_dict, model_to_yaml
from gyrocal_ros.effects.scale import scale_power
from gyrocal_ros.effects.turn_hysteresis import TurnHysteresis
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.files import shipped
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.sensor import GyroTerm, placed

SECOND_ORDER = (find_effect('scale_power_4'), find_effect('scale_power_9'))


COVARIATES = (covariate_bias('battery_state.voltage', 15.0), covariate_scale('battery_state.voltage', 15.0))
LIBRARY = (*EFFECTS.values(), *SECOND_ORDER, TurnHysteresis(driven_by='side'), *COVARIATES)


def acting_on(*places: str) -> pytest.MarkDecorator:
    chosen = [effect for effect in LIBRARY if effect.acts_on in places]
    return pytest.mark.parametrize('effect', chosen, ids=lambda effect: effect.name)


@acting_on('gyro')
class TestEachGyroEffect(GyroEffectContract):
    pass


@acting_on('wheels', 'ground')
class TestEachMotionEffect(MotionEffectContract):
    pass


@acting_on('camera')
class TestEachCameraEffect(CameraEffectContract):
    pass


@acting_on('time')
class TestEachTimeEffect(EffectContract):
    pass


def test_the_table_goes_by_the_names() -> None:
    assert all(effect.name == name for name, effect in EFFECTS.items())


def test_powers_of_the_nominal_rate() -> None:
    block = eventful_block()
    for power in (1, 2, 3, 5):
        term = scale_power(power)
        np.testing.assert_allclose(
            term.contribute(block, np.array([0.5]), None).rate_rad_s, 0.5 * block.rate_rad_s[:, 2] ** power
        )
        assert term.coefficients[0].name == f'a{power}'
    assert [scale_power(power).coefficients[0].unit for power in (1, 2, 3)] == ['1', 's/rad', 's^2/rad^2']


def warmup(block: MotionBlock, values: list[float]) -> GyroTerm:
    return BiasWarmup().contribute(block, np.array(values), None)


def test_warmup_fades_and_leaves_the_bias_its_meaning() -> None:
    block = eventful_block(2)
    at = {
        time_s: warmup(replace(block, time_s=np.full(2, time_s)), [0.01, 300.0]).rate_rad_s
        for time_s in (0.0, 300.0, 1e5)
    }
    assert at[0.0] == pytest.approx(-0.01)
    assert at[300.0] == pytest.approx(-0.01 / math.e)
    assert at[1e5] == pytest.approx(0.0)


def test_warmup_bears_any_time_constant() -> None:
    for time_constant in (-5.0, 0.0, 1e-9):
        term = warmup(eventful_block(), [0.01, time_constant])
        assert np.isfinite(term.rate_rad_s).all()
        assert np.isfinite(term.by_values).all()


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
def test_an_unknown_effect_is_refused_with_the_nearest(name: str, hint: str) -> None:
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


def test_a_model_without_a_name_is_called_after_its_file(tmp_path: Path) -> None:
    file = tmp_path / 'warm.yaml'
    file.write_text('effects: [scale_factor, bias_warmup]')
    assert load_model(file).name == 'warm'


def test_names_count_where_a_term_has_several_coefficients() -> None:
    model = model_from_dict({'effects': ['scale_factor', 'bias_warmup']}, 'm.yaml')
    assert model.coefficient_names[0] == 'scale_factor'
    gyro_effects = placed(model.effects, 'gyro')
    added = correct(gyro_effects, eventful_block(), np.array([0.1, 0.0, 500.0]), (None, None))
    np.testing.assert_allclose(added.rate_rad_s, 0.1 * eventful_block().rate_rad_s[:, 2])
    assert added.by_values.shape == (12, 3)


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
def test_a_model_that_cannot_be_used_is_refused(tree: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        model_from_dict(tree, 'my_model.yaml')
    assert 'my_model.yaml' in caught.value.where


@pytest.mark.parametrize('text', ['', '[scale_factor]', 'effects: [', '\x00'])
def test_a_file_that_is_no_model_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'model.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match='model.yaml'):
        load_model(file)


def test_a_missing_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='cannot be read'):
        load_model(tmp_path / 'none.yaml')


def test_every_effect_goes_through_the_file_of_a_model() -> None:
    model = model_from_dict({'name': 'all', 'effects': list(EFFECTS)}, 'all.yaml')
    assert model_from_dict(model_to_dict(model), 'all.yaml') == model
