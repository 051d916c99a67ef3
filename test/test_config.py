"""Settings: bounds, names, files and round trips."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gyrocal_ros.config.declare import Setting, flat_settings, to_dict, to_yaml, with_settings
from gyrocal_ros.config.parameter_file import load_config
from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config
from gyrocal_ros.config.yaml_file import read_yaml
from gyrocal_ros.errors import ConfigError, did_you_mean
from gyrocal_ros.files import shipped

SETTINGS = [(config, *item) for config in (Config(), RobotConfig()) for item in flat_settings(config)]
NUMBERS = [item for item in SETTINGS if type(item[2]) in (int, float)]


def nested(name: str, value: Any) -> Mapping[str, Any]:
    section, setting = name.split('.')
    return {section: {setting: value}}


def other_value(value: Any, spec: Setting) -> Any:
    """Return an allowed value that differs from the default."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return spec.choices[-1] if spec.choices else f'{value} {"long " * 40}: #\'"'
    return spec.high if value != spec.high else spec.low


# --- every setting ------------------------------------------------------------------------------


@pytest.mark.parametrize(('config', 'name', 'value', 'spec'), SETTINGS, ids=[item[1] for item in SETTINGS])
def test_a_setting_is_declared_completely(config: Any, name: str, value: Any, spec: Setting) -> None:
    assert spec.help and not spec.help.endswith('.')
    assert with_settings(config, nested(name, value)) == config, 'the default is within its own bounds'
    if spec.choices:
        assert value in spec.choices
    if type(value) in (int, float, tuple):
        assert spec.low is not None and spec.high is not None


@pytest.mark.parametrize(('config', 'name', 'value', 'spec'), NUMBERS, ids=[item[1] for item in NUMBERS])
def test_a_number_must_be_within_its_bounds(config: Any, name: str, value: Any, spec: Setting) -> None:
    assert spec.low is not None and spec.high is not None
    kind = type(value)
    for bound in (spec.low, spec.high):
        changed = with_settings(config, nested(name, kind(bound)))
        assert to_dict(changed)[name.split('.')[0]][name.split('.')[1]] == bound
    for beyond in (spec.low - max(abs(spec.low), 1.0), spec.high + max(abs(spec.high), 1.0)):
        with pytest.raises(ConfigError, match=name) as caught:
            with_settings(config, nested(name, kind(beyond)), 'mine.yaml')
        assert caught.value.where == 'mine.yaml'
        assert f'{spec.low} to {spec.high}' in caught.value.todo


# --- invalid values and names -------------------------------------------------------------------


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'camera': {'pixel_noise_px': math.nan}}, 'camera.pixel_noise_px is nan'),
        ({'camera': {'pixel_noise_px': math.inf}}, 'camera.pixel_noise_px is inf'),
        ({'camera': {'pixel_noise_px': '0.3 px'}}, "must be a float, not '0.3 px'"),
        ({'camera': {'pixel_noise_px': True}}, 'must be a float, not True'),
        ({'camera': {'pixel_noise_px': None}}, 'must be a float, not None'),
        ({'camera': {'estimate_pixel_noise': 1}}, 'must be a bool, not 1'),
        ({'features': {'map_size': 10.0}}, 'map_size must be a int, not 10.0'),
        (
            {'features': {'parametrisation': 'inverse depth'}},
            'choose from inverse_depth, camera_frame, pixel',
        ),
        ({'camera': {'pixel_nois_px': 0.3}}, "section camera: .*did you mean 'pixel_noise_px'"),
        ({'camra': {}}, "did you mean 'camera'"),
        ({'xyz': {}}, 'known are gyro, wheels, camera'),
        ({'camera': 0.3}, "section 'camera' contains no settings"),
        ({3: {}}, '3 is not known'),
    ],
)
def test_invalid_settings_are_refused(settings: Mapping[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        with_settings(Config(), settings)


def test_integers_are_accepted_as_floats() -> None:
    noise = with_settings(Config(), {'camera': {'pixel_noise_px': 1}}).camera.pixel_noise_px
    assert noise == 1.0 and isinstance(noise, float)


def test_other_settings_are_unchanged() -> None:
    changed = with_settings(Config(), {'features': {'map_size': 50}, 'rest': {'settle_s': 1.0}})
    assert changed == replace(
        Config(), features=replace(Config().features, map_size=50), rest=replace(Config().rest, settle_s=1.0)
    )


def test_a_setting_may_be_several_numbers() -> None:
    changed = with_settings(RobotConfig(), {'board': {'gyro_zero': [1, 2.5, -3.0]}})
    assert changed.board.gyro_zero == (1.0, 2.5, -3.0)
    assert to_dict(changed)['board']['gyro_zero'] == [1.0, 2.5, -3.0]
    for wrong, message in (
        ([1.0, 2.0], 'must be 3 numbers'),
        ('abc', 'must be 3'),
        ([0.0, 1e99, 0.0], r'\[1\]'),
    ):
        with pytest.raises(ConfigError, match=message):
            with_settings(RobotConfig(), {'board': {'gyro_zero': wrong}})


def test_the_nearest_name_is_suggested() -> None:
    assert did_you_mean('scael', ['scale', 'bias']) == "did you mean 'scale'?"
    assert did_you_mean('zzz', ['scale', 'bias']) == 'known are scale, bias'


# --- files --------------------------------------------------------------------------------------


def test_the_installed_settings_file_contains_the_defaults() -> None:
    assert shipped('config/gyrocal.yaml').read_text(encoding='utf-8') == to_yaml(Config(), RobotConfig())


def test_settings_survive_a_round_trip(tmp_path: Path) -> None:
    changed = Config()
    for name, value, spec in flat_settings(Config()):
        changed = with_settings(changed, nested(name, other_value(value, spec)))
    assert all(to_dict(changed)[section] != to_dict(Config())[section] for section in to_dict(Config()))
    file = tmp_path / 'all.yaml'
    file.write_text(to_yaml(changed))
    assert load_config(file) == changed
    assert with_settings(Config(), to_dict(changed)) == changed


def test_a_file_may_contain_some_settings(tmp_path: Path) -> None:
    file = tmp_path / 'some.yaml'
    file.write_text('/**:\n  ros__parameters:\n    camera: {pixel_noise_px: 2e-1}\n')
    assert load_config(file).camera.pixel_noise_px == 0.2
    assert load_config(None) == Config()


def test_a_file_for_the_nodes_is_checked_completely(tmp_path: Path) -> None:
    file = tmp_path / 'robot.yaml'
    file.write_text(to_yaml(Config(), RobotConfig()))
    assert load_config(file) == Config()
    file.write_text('/driver: {ros__parameters: {driver: {baud_rat: 9600}}}')
    with pytest.raises(ConfigError, match="did you mean 'baud_rate'"):
        load_config(file)


def test_a_file_may_serve_several_nodes(tmp_path: Path) -> None:
    file = tmp_path / 'robot.yaml'
    file.write_text(
        '/driver: {ros__parameters: {driver.port: /dev/ttyUSB0, gyro: {rate_noise_deg_s: 0.01}}}\n'
        '/tracker: {ros__parameters: {use_sim_time: true}}\n'
        '/calibrator: {ros__parameters: {features.map_size: 50, features: {ray_std_m: 50.0}}}\n'
    )
    config = load_config(file)
    assert config.gyro.rate_noise_deg_s == 0.01
    assert (config.features.map_size, config.features.ray_std_m) == (50, 50.0)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'contains no settings'),
        ('just words', 'contains no settings'),
        ('a: [', 'is not valid YAML'),
        ('camera: {pixel_noise_px: 0.3}', 'no ros__parameters'),
        ('/**: 3', 'no ros__parameters'),
        ('/**: {ros__parameters: {camera: {}, camera: {}}}', "'camera' is given twice"),
        ('/**: {ros__parameters: {camera: {pixel_noise: 0.3}}}', "did you mean 'pixel_noise_px'"),
        ('/**: {ros__parameters: {camera.pixel_noise: 0.3}}', "did you mean 'pixel_noise_px'"),
        ('/**: {ros__parameters: {camera: {pixel_noise_px: 300.0}}}', '0.005 to 20.0 px'),
        ('/**: {ros__parameters: {camra: 3}}', "did you mean 'camera'"),
        ('/**: {ros__parameters: {camra.pixel_noise_px: 0.3}}', "did you mean 'camera'"),
        ('/**: {ros__parameters: {pixel_noise_px: 0.3}}', "'pixel_noise_px' is not known"),
        ('/**: {ros__parameters: {rest: {settle_s: 1.0}}, camera: {}}', "'camera' is not known here"),
        ('/**: {ros__parameters: {camera: 0.3, camera.pixel_noise_px: 0.3}}', 'contains no settings'),
        ('/**: {ros__parameters: {camera.pixel_noise_px: 0.3, camera: 0.3}}', 'contains no settings'),
    ],
)
def test_an_invalid_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / 'mine.yaml'
    file.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(file)
    assert str(file) in caught.value.where


def test_an_unreadable_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='cannot be read'):
        load_config(tmp_path / 'none.yaml')
    with pytest.raises(ConfigError, match='cannot be read'):
        load_config(tmp_path)
    file = tmp_path / 'latin.yaml'
    file.write_bytes(b'name: \xe9')
    with pytest.raises(ConfigError, match='is not valid YAML'):
        load_config(file)


@pytest.mark.parametrize('text', ['1e-3', '1E-3', '1.e-3', '0.1e-2', '+1e-3'])
def test_numbers_in_exponential_notation_are_loaded(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'number.yaml'
    file.write_text(f'value: {text}')
    assert read_yaml(file) == {'value': 1e-3}


@pytest.mark.parametrize('text', ['e3', '1e', '1-3', "'1e-3'", 'a1e-3', '0x1e-3'])
def test_text_similar_to_numbers_stays_text(text: str, tmp_path: Path) -> None:
    file = tmp_path / 'word.yaml'
    file.write_text(f'value: {text}')
    assert isinstance(read_yaml(file)['value'], str)
