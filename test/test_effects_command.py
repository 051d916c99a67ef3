"""`gyrocal effects`: the list, the description of an effect, and its page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli.main import main
from gyrocal_ros.effects import COVARIATE_EFFECTS, EFFECTS, find_effect
from gyrocal_ros.effects.sketch import MAX_LINES, sketch

Output = pytest.CaptureFixture[str]


LEARNED = [
    *('bias_curve:rate', 'bias_curve:heading', 'scale_curve:force_y', 'bias_curve:battery_state.voltage'),
    *('bias_memory:dynamics', 'bias_memory:temperature', 'scale_memory:start', 'bias_memory:fan.data'),
    *('bias_map:place', 'scale_step:time'),
]


def test_the_list_has_a_line_for_every_effect(capsys: Output) -> None:
    assert main(['effects']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0].split(':')[0] for line in lines[1:]] == [*EFFECTS, *COVARIATE_EFFECTS]
    assert max(map(len, lines)) <= 110


def test_the_list_as_json(capsys: Output) -> None:
    assert main(['effects', '--json']) == 0
    listed = json.loads(capsys.readouterr().out)['effects']
    lag = next(item for item in listed if item['name'] == 'gyro_lag')
    assert lag['acts_on'] == 'gyro'
    assert lag['twins'] == ['camera_time_offset']
    assert lag['coefficients'][0] | {'example': None} == {
        'name': 'tau', 'unit': 's', 'prior_mean': 0.0, 'prior_std': 0.03, 'walk': 0.0, 'example': None
    }  # fmt: skip


@pytest.mark.parametrize(
    'name',
    [*EFFECTS, *COVARIATE_EFFECTS, 'covariate_bias:fan_speed.data', 'scale_power_4', *LEARNED],
)
def test_every_effect_has_a_description(name: str, capsys: Output) -> None:
    assert main(['effects', name]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(name)
    for row in ('equation', 'usual size', 'best motion', 'easily taken for', 'needs', 'source'):
        assert f'\n{row} ' in printed
    assert max(map(len, printed.splitlines())) <= 100


def test_the_page_of_an_effect(tmp_path: Path, capsys: Output) -> None:
    page = tmp_path / 'lag.html'
    assert main(['effects', 'gyro_lag', '-o', str(page)]) == 0
    assert str(page) in capsys.readouterr().out
    text = page.read_text(encoding='utf-8')
    assert 'low-pass' in text
    assert 'read, tau = 0.02 s' in text
    assert main(['effects', 'gyro_lag', '-o', str(page)]) == 2
    assert 'exists already' in capsys.readouterr().err
    assert main(['effects', 'gyro_lag', '-o', str(page), '--overwrite', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['name'] == 'gyro_lag'


@pytest.mark.parametrize('name', LEARNED)
def test_the_sketch_of_a_learned_effect_shows_something(name: str) -> None:
    drawn = sketch(find_effect(name))
    assert 0 < len(drawn.lines) <= MAX_LINES
    assert all(np.any(line) and np.all(np.isfinite(line)) for line in drawn.lines.values())


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [(['gyro_lagg'], "did you mean 'gyro_lag'?"), (['-o', 'page.html'], 'give its name')],
)
def test_bad_arguments_are_refused(arguments: list[str], message: str, capsys: Output) -> None:
    assert main(['effects', *arguments]) == 2
    assert message in capsys.readouterr().err
