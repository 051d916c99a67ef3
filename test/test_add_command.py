"""`gyrocal add`: the effect is added, and everything else in the file is kept."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.cli.add import model_entry
from gyrocal_ros.cli.main import main
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import EFFECTS, default_model, find_effect
from gyrocal_ros.effects.base import LibraryEffect
from gyrocal_ros.effects.covariate import covariate_bias, covariate_scale
from gyrocal_ros.effects.library import SCALE_FACTOR
from gyrocal_ros.effects.model_file import load_model, options_of
from gyrocal_ros.effects.quantities import add_words
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW
from gyrocal_ros.model.sensor import Effect, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.report.describe import coefficients_in_words

Output = pytest.CaptureFixture[str]

TEXTS = {
    'block': """# mine
name: kitchen  # the small one
effects:
- scale_factor
# - gyro_lag, perhaps
version: 7
""",
    'nested': """version: 7
effects:
    - scale_factor
    - name: scale_cubic
      prior_std:
        a3: 1e-3  # wide

# end
""",
    'flow': """effects: [scale_factor, {name: scale_cubic, prior_std: 1e-3}]  # short
version: 7
""",
    'lines': """version: 7
effects: [
  scale_factor,
  scale_cubic  # bends
]
""",
    'no end of line': """version: 7
bias: {form: settling, time_constant_s: 300}
effects:
  - scale_factor""",
}


def names_of(path: Path) -> list[str]:
    return [effect.name for effect in load_model(path).effects]


def test_a_new_model_starts_as_the_default_one(tmp_path: Path, capsys: Output) -> None:
    path = tmp_path / 'model.yaml'
    assert main(['add', 'gyro_lag', '--model', str(path)]) == 0
    assert capsys.readouterr().out == f'{path}: scale_factor, gyro_lag\n'
    assert names_of(path) == ['scale_factor', 'gyro_lag']
    assert path.read_text(encoding='utf-8').startswith('# Initial sensor model of a robot.')


@pytest.mark.parametrize('effect', ['gyro_lag', 'covariate_bias:battery_state.current'])
@pytest.mark.parametrize('case', TEXTS)
def test_the_rest_of_the_file_is_kept(tmp_path: Path, case: str, effect: str) -> None:
    path, text = tmp_path / 'model.yaml', TEXTS[case]
    path.write_text(text, encoding='utf-8')
    before = load_model(path)
    assert main(['add', effect, '--model', str(path)]) == 0
    after = load_model(path)
    assert after.effects[:-1] == before.effects and after.effects[-1].name == effect
    assert (after.name, after.bias, after.version) == (before.name, before.bias, 8)
    left = path.read_text(encoding='utf-8').replace('version: 8', 'version: 7').rstrip()
    start = len(os.path.commonprefix([left, text.rstrip()]))
    end = start + len(left) - len(text.rstrip())
    assert left[:start] + left[end:] == text.rstrip()


def test_an_effect_of_the_model_is_reported_and_not_changed(tmp_path: Path, capsys: Output) -> None:
    path = tmp_path / 'model.yaml'
    path.write_text(TEXTS['nested'], encoding='utf-8')
    assert main(['add', 'scale_cubic', '--model', str(path)]) == 0
    assert 'has scale_cubic already' in capsys.readouterr().out
    assert path.read_text(encoding='utf-8') == TEXTS['nested']


def test_a_signal_without_a_reference_is_told_to_count_from_zero(tmp_path: Path, capsys: Output) -> None:
    path, current = tmp_path / 'model.yaml', 'covariate_scale:battery_state.current'
    assert main(['add', current, '--model', str(path)]) == 0
    assert 'battery_state.current counts from 0' in capsys.readouterr().err
    voltage = ['covariate_bias:battery_state.voltage', '--set', 'reference=16']
    assert main(['add', *voltage, '--model', str(path)]) == 0
    assert main(['add', 'gyro_lag', '--model', str(path)]) == 0
    assert not capsys.readouterr().err


def test_prior_means_and_options_can_be_set(tmp_path: Path) -> None:
    path = tmp_path / 'model.yaml'
    assert main(['add', 'rate_saturation', '--set', 'limit=1.05', '--model', str(path)]) == 0
    hysteresis = ['turn_hysteresis', '--set', 'driven_by=side', '--set', 'time_constant=8']
    assert main(['add', *hysteresis, '--model', str(path)]) == 0
    _, saturation, hysteresis_effect = load_model(path).effects
    assert saturation.coefficients[0].prior_mean == 1.05
    assert getattr(hysteresis_effect, 'driven_by') == 'side'  # noqa: B009
    assert hysteresis_effect.coefficients[1].prior_mean == 8.0
    assert hysteresis_effect.coefficients[0].prior_std == math.radians(1.0)


@pytest.mark.parametrize('effect', [*EFFECTS.values(), find_effect('covariate_bias:battery.current')])
def test_values_may_be_set_as_they_are_displayed(effect: LibraryEffect, tmp_path: Path) -> None:
    values = np.array(effect.about.example)
    shown = coefficients_in_words(effect, values, np.zeros(len(values)))
    entry = model_entry(effect.name, shown.split(', '))
    assert isinstance(entry, dict)
    assert list(entry['prior_mean'].values()) == pytest.approx(values.tolist(), rel=1e-3)
    stds = np.abs(0.1 * values) + 1e-6
    shown = coefficients_in_words(effect, values, stds)
    entry = model_entry(effect.name, shown.split(', '))
    assert isinstance(entry, dict)
    assert list(entry['prior_std'].values()) == pytest.approx(stds.tolist(), rel=0.05)


def with_examples(effect: LibraryEffect) -> Effect:
    """Return an effect with the priors of a diagnosis: the estimates, narrower than usual."""
    items = zip(effect.coefficients, effect.about.example, strict=True)
    return replace(  # type: ignore[type-var,return-value]
        effect,
        coefficients=tuple(
            replace(item, prior_mean=1.2345678 * example, prior_std=0.31 * item.prior_std)
            for item, example in items
        ),
    )


VARIANTS = (
    *(effect for name, effect in EFFECTS.items() if name != SCALE_FACTOR),
    replace(EFFECTS['turn_hysteresis'], driven_by='side'),  # type: ignore[type-var]
    covariate_bias('battery.current', reference=101325.25, spread=0.123),
    covariate_scale('battery.current', reference=-1.61605, spread=2.5),
)


@pytest.mark.parametrize('usual', VARIANTS, ids=str)
def test_the_recommended_command_adds_the_effect_as_it_was_found(
    usual: LibraryEffect, tmp_path: Path
) -> None:
    path, found = tmp_path / 'model.yaml', with_examples(usual)
    path.write_text('effects: [scale_factor]', encoding='utf-8')
    assert main([*add_words(found)[1:], '--model', str(path)]) == 0
    added = load_model(path).effects[-1]
    assert options_of(added) == pytest.approx(options_of(found))
    for item, wanted in zip(added.coefficients, found.coefficients, strict=True):
        assert item.prior_mean == pytest.approx(wanted.prior_mean, rel=1e-7 if not wanted.prior_std else 1e-3)
        assert item.prior_std == pytest.approx(wanted.prior_std, rel=0.06)
        assert item.walk == wanted.walk


def test_an_effect_that_is_as_usual_needs_no_settings() -> None:
    assert add_words(EFFECTS['gyro_lag']) == ['gyrocal', 'add', 'gyro_lag']


def test_a_value_that_alone_differs_is_part_of_the_command() -> None:
    effect = with_means(EFFECTS['gyro_lag'], (0.02,))
    assert add_words(effect)[3:] == ['--set', 'tau=0.02+-0.03s']


def test_the_model_that_was_added_runs_as_the_one_that_was_found(tmp_path: Path) -> None:
    path, source = tmp_path / 'model.yaml', recording('cleaning', 3, 40.0)
    names = ('scale_asymmetry', 'bias_warmup', 'turn_hysteresis', 'camera_time_offset')
    found = [with_examples(EFFECTS[name]) for name in names]
    model = default_model()
    wanted = calibrate(source, Config(), replace(model, effects=(*model.effects, *found)))
    path.write_text('effects: [scale_factor]', encoding='utf-8')
    for effect in found:
        assert main([*add_words(effect)[1:], '--model', str(path)]) == 0
    run = calibrate(source, Config(), load_model(path))
    reached = run.history.std[-1, COEFFICIENTS_START:]
    assert np.all(np.abs(run.state.coefficients - wanted.state.coefficients) < 0.05 * reached)
    assert np.allclose(run.history.mean[:, YAW], wanted.history.mean[:, YAW], rtol=0.0, atol=1e-5)


def test_another_file_is_written_and_none_is_overwritten(tmp_path: Path, capsys: Output) -> None:
    first, second = tmp_path / 'model.yaml', tmp_path / 'new.yaml'
    first.write_text(TEXTS['block'], encoding='utf-8')
    arguments = ['add', 'gyro_lag', '--model', str(first), '-o', str(second)]
    assert main(arguments) == 0
    assert first.read_text(encoding='utf-8') == TEXTS['block']
    assert names_of(second) == ['scale_factor', 'gyro_lag']
    second.write_text('mine', encoding='utf-8')
    assert main(arguments) == 2
    assert 'exists already' in capsys.readouterr().err
    assert second.read_text(encoding='utf-8') == 'mine'
    assert main([*arguments, '--overwrite']) == 0
    assert names_of(second) == ['scale_factor', 'gyro_lag']


@pytest.mark.parametrize(
    ('text', 'arguments', 'message'),
    [
        (TEXTS['block'], ['gyro_lagg'], "did you mean 'gyro_lag'?"),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau'], 'write it as NAME=VALUE'),
        (TEXTS['block'], ['gyro_lag', '--set', 'tua=1'], "did you mean 'tau'?"),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau=long'], "tau is 'long'"),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau=1e999'], 'tau is inf'),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau=20ms'], 'give it in s'),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau=0.02+-0s'], 'one above zero'),
        (TEXTS['block'], ['gyro_lag', '--set', 'tau=0.02+-1e999'], 'prior_std'),
        (TEXTS['block'], ['gyro_lag', '--set', 'prior_std=1'], "no coefficient or option 'prior_std'"),
        (TEXTS['block'], ['turn_hysteresis', '--set', 'driven_by=sides'], 'choose from rate, side'),
        ('effects: [gyro_lag]', ['scale_cubic'], 'the first effect must be scale_factor'),
        ('usual: &usual\n- scale_factor\neffects: *usual\n', ['scale_cubic'], 'are not supported'),
        (
            'effects:\n- scale_factor\n- |-\n  gyro_lag\nversion: 7\n',
            ['scale_cubic'],
            'under effects by hand',
        ),
    ],
)
def test_errors_are_reported_and_nothing_is_written(
    tmp_path: Path, capsys: Output, text: str, arguments: list[str], message: str
) -> None:
    path = tmp_path / 'model.yaml'
    path.write_text(text, encoding='utf-8')
    assert main(['add', *arguments, '--model', str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert path.read_text(encoding='utf-8') == text
