"""Which motion separates which effects: the figures that come with the package, and the advice."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.bench import separability as bench
from gyrocal_ros.bench.separability import Figures, Lost, figures
from gyrocal_ros.cli.output import print_row
from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import examine
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.separability import (
    MIN_SEPARATION,
    best_drive,
    drive_for,
    how_to_tell_apart,
    kind_of,
    table,
)
from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS, default_model, find_effect
from gyrocal_ros.effects.traits import is_noise
from gyrocal_ros.errors import ConfigError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.drives import CONTROLS, EVERYDAY, TEST_DRIVES
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.world import SimSource

PAGE = Path(__file__).resolve().parent.parent / 'docs' / 'drives.md'


@pytest.fixture(scope='module')
def speeds() -> Figures:
    return figures('speeds')


@pytest.mark.slow
def test_the_figures_are_those_of_this_code(speeds: Figures) -> None:
    for name, sigma in speeds.shows.items():
        assert table().significance[name]['speeds'] == pytest.approx(sigma, rel=0.05, abs=0.5), name
    for pair, row in table().correlations.items():
        first, second = sorted(pair)
        assert row['speeds'] == pytest.approx(speeds.alike.get((first, second)), abs=0.02), pair


def test_the_figures_cover_the_library_and_every_drive() -> None:
    effects = {name for name, effect in EFFECTS.items() if not is_noise(effect)}
    assert table().significance.keys() == {*effects, *COVARIATE_EFFECTS}
    rows = [
        set(row) for table_of in (table().significance, table().correlations) for row in table_of.values()
    ]
    assert all(row == {EVERYDAY.name, *TEST_DRIVES, *CONTROLS} for row in rows)
    drives = {EVERYDAY.name: EVERYDAY, **TEST_DRIVES}
    assert table().drives == {name: drive.about for name, drive in drives.items()}
    assert table().everyday == EVERYDAY.name


@pytest.mark.slow
def test_the_separation_of_two_effects_is_what_the_other_cannot_explain(speeds: Figures) -> None:
    pair = ('scale_asymmetry', 'scale_quadratic')
    weaker = min(speeds.shows[name] for name in pair)
    expected = weaker * math.sqrt(1.0 - speeds.alike[pair] ** 2)
    assert table().separation(*pair, 'speeds') == pytest.approx(expected, rel=0.05)
    cubic = table().significance['scale_cubic']['speeds']
    assert table().separation('scale_cubic', 'scale_factor', 'speeds') == cubic, (
        'the scale factor is free already'
    )
    assert table().separation('gyro_lag', 'camera_tilt', 'speeds') > 0.4 * min(
        table().significance[name]['speeds'] for name in ('gyro_lag', 'camera_tilt')
    ), 'a pair without a row has at most the correlation of one with a row'


@pytest.mark.parametrize(
    ('first', 'second', 'drive'),
    [
        ('scale_cubic', 'scale_factor', 'speeds'),
        ('scale_asymmetry', 'scale_quadratic', 'speeds'),
        ('bias_temperature', 'bias_warmup', 'cooled'),
    ],
)
def test_effects_that_look_alike_have_a_drive_that_separates_them(
    first: str, second: str, drive: str
) -> None:
    found = best_drive(first, second)
    assert found.helps and found.drive == drive
    assert found.sigma > found.everyday_sigma
    assert found.everyday_correlation is not None and found.correlation < found.everyday_correlation
    assert best_drive(second, first).drive == drive


def test_no_drive_separates_wheel_scale_and_the_place_of_the_camera() -> None:
    found = best_drive('wheel_scale', 'camera_position')
    assert not found.helps and found.sigma < 0.1 * MIN_SEPARATION
    (sentence,) = how_to_tell_apart('wheel_scale', ['camera_position'])
    assert 'no motion' in sentence


def test_drives_that_show_wheel_scale_and_focal_length() -> None:
    wheel_scale, focal_length = table().significance['wheel_scale'], table().significance['focal_length']
    assert wheel_scale['centred'] == 0.0 and wheel_scale['level'] > 10.0
    assert focal_length['rough'] > 20.0 > focal_length['square'] > focal_length['level']
    assert focal_length['pinhole'] < 4.5


def test_advice_is_a_sentence_for_each_alternative() -> None:
    others = ['scale_factor', 'rate_saturation']
    sentences = how_to_tell_apart('scale_cubic', others)
    for other, sentence in zip(others, sentences, strict=True):
        assert sentence.startswith(
            f'To tell scale_cubic from {other}, record five minutes of this: three full'
        )
        assert 'sigma' in sentence and sentence.endswith('.')
    assert how_to_tell_apart('scale_cubic', []) == []


def test_advice_on_recorded_signals() -> None:
    fan, motor = 'covariate_bias:fan.rpm', 'covariate_bias:motor.current'
    to_fan, to_temperature = how_to_tell_apart(motor, [fan, 'bias_temperature'])
    assert 'without the other' in to_fan and TEST_DRIVES['fan'].about in to_temperature
    assert kind_of(fan) == 'covariate_bias' and kind_of('scale_cubic') == 'scale_cubic'


def test_the_drive_that_shows_an_effect_best() -> None:
    assert drive_for('rate_deadband') == TEST_DRIVES['creeping'].about
    assert drive_for('covariate_bias:fan.rpm') == TEST_DRIVES['fan'].about
    assert drive_for('scale_power_4') is None, 'it has no figures'


def test_advice_on_effects_without_figures_is_their_best_motion() -> None:
    (sentence,) = how_to_tell_apart('scale_power_4', ['scale_cubic'])
    for name in ('scale_power_4', 'scale_cubic'):
        assert find_effect(name).about.best_motion in sentence
    with pytest.raises(ConfigError, match='scale_power_4'):
        best_drive('scale_power_4', 'scale_cubic')


@pytest.mark.slow
def test_a_diagnosis_on_the_advised_drive_finds_the_effect() -> None:
    effect, other = find_effect('bias_temperature'), 'bias_warmup'
    drive = TEST_DRIVES[best_drive(effect.name, other).drive]
    slow = replace(drive, imu_hz=100, camera_hz=4)
    source = SimSource(slow, seed=3, hidden=(HiddenEffect(effect, (math.radians(0.02),)),))
    examined = examine(
        default_model(),
        summarise_recording(source),
        lambda model, candidates: calibrate(source, Config(), model, candidates=candidates),
    )
    gains = {item.effect.name: item.fit.gain for item in examined.ranked}
    assert examined.ranked[0].effect.name == effect.name
    assert gains[effect.name] > 2.0 * gains[other]


def test_the_rate_lost_beyond_a_limit_is_a_column() -> None:
    block = eventful_block()
    rate = block.rate_rad_s[:, 2]
    limit = 0.5 * float(np.abs(rate).max())
    lost = Lost(EFFECTS['rate_saturation'], (limit,), 'rate_saturation')  # type: ignore[arg-type]
    assert lost.columns(block)[:, 0] == pytest.approx(rate - np.clip(rate, -limit, limit))


def test_the_table_has_the_figures_of_each_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    def invented(drive: str) -> Figures:
        shows = dict.fromkeys(('scale_cubic', 'gyro_lag', 'turn_slip'), 10.0)
        alike = {('gyro_lag', 'turn_slip'): 0.95 if drive == 'rough' else 0.1}
        return Figures(shows, alike)

    monkeypatch.setattr(bench, 'in_parallel', map)
    monkeypatch.setattr(bench, 'figures', invented)
    rows = {row['effect']: row for row in bench.motions()}
    assert rows['scale_cubic']['speeds'] == 10.0 and rows['wheel_scale']['speeds'] == 0.0
    assert rows['gyro_lag/turn_slip']['rough'] == 0.95
    assert rows['camera_time_offset/gyro_lag']['rough'] is None, (
        'declared to look alike, but not shown by any drive'
    )
    assert 'gyro_lag/scale_cubic' not in rows


def test_the_page_shows_the_figures(capsys: pytest.CaptureFixture[str]) -> None:
    text = files('gyrocal_ros.diagnose').joinpath('separability.json').read_text(encoding='utf-8')
    for number, row in enumerate(json.loads(text)['rows']):
        print_row(row, header=number == 0)
    page = PAGE.read_text(encoding='utf-8')
    for line in capsys.readouterr().out.splitlines():
        assert line in page, 'paste the output of `gyrocal bench motions`'
    assert all(sentence in page for sentence in how_to_tell_apart('bias_warmup', ['bias_temperature']))
    for drive in (*TEST_DRIVES.values(), *CONTROLS.values()):
        assert f'| `{drive.name}` | {drive.about} |' in page


@pytest.mark.parametrize('name', sorted(TEST_DRIVES))
def test_test_drives_stay_in_the_room(name: str) -> None:
    source = SimSource(TEST_DRIVES[name])
    time_s = np.arange(0.0, source.scenario.duration_s, 0.1)
    assert np.abs(source.truth.position(time_s)[:, :2]).max() < 2.0
    motion = source.truth.trajectory.motion(time_s)
    assert np.all(motion.speed_m_s[time_s < 3.0] == 0.0)
    assert np.degrees(np.abs(motion.rate_rad_s[:, 2])).max() < 95.0


def test_cooling_reverses_the_warming_up() -> None:
    climate = SimSource(TEST_DRIVES['cooled']).truth.climate
    start, middle, end = climate.temperature_c(np.array([0.0, 150.0, 300.0]))
    assert middle - start > 5.0 and middle - end > 4.0
    fan = SimSource(TEST_DRIVES['fan']).truth.fan.speed(np.arange(0.0, 300.0, 1.0))
    assert fan.min() == 0.0 and fan.max() == pytest.approx(0.95)
