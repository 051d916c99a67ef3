"""Recordings with hidden effects: the draws, the sealed answer, and the commands for them."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli.main import main
from gyrocal_ros.effects import EFFECTS, find_effect
from gyrocal_ros.errors import ConfigError, RecordingError
from gyrocal_ros.sim.hidden import (
    LIBRARY_RANGES,
    NOISES,
    OUT_OF_LIBRARY_RANGES,
    SCALE_ERROR,
    DrawnEffect,
    draw_hidden,
    draw_scale_factor,
    draw_values,
    hide,
)
from gyrocal_ros.sim.out_of_library import OUT_OF_LIBRARY
from gyrocal_ros.sim.scenarios import SCENARIOS
from gyrocal_ros.sim.sealed import answer_of, sealed_path, unseal
from gyrocal_ros.sim.world import SimSource

SIZED = {**LIBRARY_RANGES, **OUT_OF_LIBRARY_RANGES}


def simulate(out: Path, *options: str) -> int:
    return main(['simulate', str(out), '--duration', '5', *options])


def digest(bag: Path) -> str:
    return hashlib.sha256(b''.join(file.read_bytes() for file in sorted(bag.iterdir()))).hexdigest()


# --- draws --------------------------------------------------------------------------------------


def test_every_effect_can_be_drawn() -> None:
    assert set(EFFECTS) - {'scale_factor'} <= set(LIBRARY_RANGES)
    assert set(OUT_OF_LIBRARY_RANGES) == set(OUT_OF_LIBRARY)


@pytest.mark.parametrize('name', SIZED)
def test_sizes_run_from_just_visible_to_large(name: str) -> None:
    rng = np.random.default_rng(0)
    draws = np.array([draw_values(name, rng, 1.0).values for _ in range(200)])
    assert draws.shape[1] == len(hide([DrawnEffect(name, tuple(draws[0]))], find_effect)[0].values)
    for values, item in zip(draws.T, SIZED[name], strict=True):
        low, high = sorted((item.low, item.high))
        assert np.all((np.abs(values) >= low * 0.999) & (np.abs(values) <= high * 1.001))
        assert np.median(np.abs(values)) == pytest.approx((low * high) ** 0.5, rel=0.35)
        assert np.any(values < 0.0) == item.signed
    assert draw_values(name, rng, 1.0, size=1.0).values[0] in (
        pytest.approx(SIZED[name][0].high),
        pytest.approx(-SIZED[name][0].high),
    )


def test_draws_depend_on_the_seed_alone() -> None:
    assert draw_hidden(5, 300.0) == draw_hidden(5, 300.0)
    assert len({draw_hidden(seed, 300.0) for seed in range(40)}) > 25
    assert draw_hidden(5, 300.0, ['gyro_lag']) != draw_hidden(6, 300.0, ['gyro_lag'])
    assert abs(draw_scale_factor(5) - 1.0) <= SCALE_ERROR


def test_nothing_one_two_and_effects_out_of_the_library_are_drawn() -> None:
    draws = [draw_hidden(seed, 300.0) for seed in range(1000)]
    unknown = sum(bool(drawn) and drawn[0].name in OUT_OF_LIBRARY for drawn in draws)
    counts = Counter(len(drawn) for drawn in draws)
    assert [counts[0], counts[1] - unknown, counts[2], unknown] == pytest.approx([200, 450, 150, 200], abs=45)
    assert {item.name for drawn in draws for item in drawn} == set(SIZED) - NOISES
    assert all(len({item.name for item in drawn}) == len(drawn) for drawn in draws)


def test_a_jump_happens_during_the_recording() -> None:
    rng = np.random.default_rng(0)
    times = [draw_values('stranger_knock', rng, 200.0).values[1] for _ in range(50)]
    assert min(times) >= 50.0
    assert max(times) <= 150.0


def test_an_effect_without_typical_ranges_is_refused() -> None:
    with pytest.raises(ConfigError, match="no sizes to draw from; did you mean 'scale_"):
        draw_hidden(0, 300.0, ['scale_power_4'])


# --- commands -----------------------------------------------------------------------------------


def test_the_answer_is_sealed_and_revealed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seed = next(seed for seed in range(99) if len(draw_hidden(seed, 5.0)) == 2)
    bag = tmp_path / 'hidden'
    assert simulate(bag, '--hidden', '--seed', str(seed)) == 0
    shown = capsys.readouterr().out
    names = [item.name for item in draw_hidden(seed, 5.0)]
    sealed = sealed_path(bag).read_text()
    assert not any(name in text for name in names for text in (shown, sealed))
    assert main(['reveal', str(bag), '--json']) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [item['effect'] for item in answer['effects']] == names
    assert answer['scale_factor'] == draw_scale_factor(seed)
    for item, drawn in zip(answer['effects'], draw_hidden(seed, 5.0), strict=True):
        assert [value['value'] for value in item['coefficients'].values()] == list(drawn.values)
    assert main(['reveal', str(next(bag.glob('*.mcap')))]) == 0
    assert all(name in capsys.readouterr().out for name in names[:1])


def test_a_bag_with_hidden_effects_is_the_bag_with_the_same_effects_given(tmp_path: Path) -> None:
    assert simulate(tmp_path / 'a' / 'bag', '--hidden', '--seed', '3') == 0
    given = [f'scale_factor={draw_scale_factor(3) - 1.0!r}']
    given += [f'{item.name}={",".join(map(repr, item.values))}' for item in draw_hidden(3, 5.0)]
    options = [part for text in given for part in ('--effect', text)]
    assert simulate(tmp_path / 'b' / 'bag', '--seed', '3', *options) == 0
    assert digest(tmp_path / 'a' / 'bag') == digest(tmp_path / 'b' / 'bag')
    assert not sealed_path(tmp_path / 'b' / 'bag').exists()


def test_effects_are_simulated_with_the_values_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ['--effect', 'bias_warmup=time_constant:100,amplitude:0.01', '--effect', 'gyro_lag']
    assert simulate(tmp_path / 'bag', *options) == 0
    shown = capsys.readouterr().out
    assert 'with bias_warmup: amplitude = 0.573 deg/s, time_constant = 100 s' in shown
    assert f'with gyro_lag: tau = {EFFECTS["gyro_lag"].about.example[0]:g} s' in shown


def test_no_hidden_effect_is_an_answer_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seed = next(seed for seed in range(99) if not draw_hidden(seed, 5.0))
    assert simulate(tmp_path / 'bag', '--hidden', '--seed', str(seed)) == 0
    assert main(['reveal', str(tmp_path / 'bag')]) == 0
    assert 'nothing' in capsys.readouterr().out


def test_the_answer_holds_the_truth_of_the_source() -> None:
    hidden = hide([DrawnEffect('stranger_knock', (0.01, 2.0))], find_effect)
    source = SimSource(SCENARIOS['demo'], 1, hidden=hidden)
    answer = answer_of(source)
    assert answer['scale_factor'] == source.truth.scale_factor
    assert answer['bias']['start'] == source.truth.bias_rad_s[0, 2]
    assert answer['effects'][0]['coefficients']['time'] == {'value': 2.0, 'unit': 's'}


@pytest.mark.parametrize(
    ('option', 'message'),
    [
        ('gyro_lagg=0.1', "did you mean 'gyro_lag'?"),
        ('gyro_lag=0.1,0.2', 'has 2 values; give gyro_lag=tau:VALUE'),
        ('gyro_lag=tu:0.1', "no coefficient 'tu'; did you mean 'tau'?"),
        ('gyro_lag=', "tau is ''; give a number in s"),
        ('gyro_lag=nan', "tau is 'nan'"),
        ('stranger_knock', 'give it, as in stranger_knock=VALUE'),
        ('covariate_bias:fan_speed.data', 'has no usual size'),
        ('covariate_bias:fan_sped.data=1e-6', "did you mean 'fan_speed.data'?"),
    ],
)
def test_effects_that_cannot_be_simulated_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, message: str
) -> None:
    assert simulate(tmp_path / 'bag', '--effect', option) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count('\n') == 1
    assert list(tmp_path.iterdir()) == []


def test_an_answer_is_not_overwritten_unasked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sealed_path(tmp_path / 'bag').write_text('of an older bag')
    assert simulate(tmp_path / 'bag', '--hidden') == 2
    assert 'exists already' in capsys.readouterr().err
    assert not (tmp_path / 'bag').exists()
    assert simulate(tmp_path / 'bag', '--hidden', '--overwrite') == 0
    assert unseal(tmp_path / 'bag')['scenario'] == 'cleaning'


def test_an_answer_that_cannot_be_revealed_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / 'bag'
    assert main(['reveal', str(bag)]) == 2
    assert 'does not exist' in capsys.readouterr().err
    assert simulate(bag) == 0
    assert main(['reveal', str(bag)]) == 2
    assert 'has no sealed answer' in capsys.readouterr().err
    for content in ('', 'header\nnot packed\n', 'header\naGVsbG8=\n', 'header\n\xe4'):
        sealed_path(bag).write_text(content, encoding='utf-8')
        with pytest.raises(RecordingError, match='damaged'):
            unseal(bag)


def test_the_answer_of_another_bag_is_refused(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    assert simulate(bag, '--hidden', '--seed', '1') == 0
    assert simulate(bag, '--seed', '2', '--overwrite') == 0
    with pytest.raises(RecordingError, match='another bag'):
        unseal(bag)
