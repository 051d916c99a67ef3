"""Effects in files of the user's: the example of the guide, and the errors of faulty files."""

from __future__ import annotations

import json
import re
import shlex
import textwrap
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from gyrocal_ros.cli.main import main
from gyrocal_ros.effects import EFFECTS, find_effect, registry
from gyrocal_ros.effects.base import column
from gyrocal_ros.effects.registry import load_file
from gyrocal_ros.errors import ConfigError

GUIDE = Path(__file__).parent.parent / 'docs' / 'your_own_effect.md'

EFFECT = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from gyrocal_ros.effects.base import Explanation, LinearGyroEffect, column
from gyrocal_ros.model.sensor import Coefficient, GyroTerm

@dataclass(frozen=True)
class Mine(LinearGyroEffect):
    about: ClassVar[Explanation] = Explanation('It is.', 'w = w_n + k', 'small', 'none', example=(0.1,))
    name: str = 'mine'
    coefficients: tuple[Coefficient, ...] = (Coefficient('k', 'rad/s', 0.1),)

    def columns(self, block):
        return column(np.ones(len(block.dt_s)))
"""

Write = Callable[[str], Path]

pytestmark = pytest.mark.usefixtures('library')


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(code: str) -> Path:
        file = tmp_path / 'my_effects.py'
        file.write_text(code)
        return file

    return written


def blocks_of_the_guide(language: str) -> list[str]:
    return re.findall(rf'```{language}\n(.*?)```', GUIDE.read_text(encoding='utf-8'), re.S)


@pytest.mark.slow
@pytest.mark.usefixtures('slow_sensors')
def test_the_example_of_the_guide_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,), (commands,), (model,) = (blocks_of_the_guide(kind) for kind in ('python', 'sh', 'yaml'))
    Path('my_effects.py').write_text(code)
    Path('model.yaml').write_text(model)
    explain, simulate, replay, diagnose = commands.strip().splitlines()
    assert main(shlex.split(explain)[1:]) == 0
    shown = capsys.readouterr().out
    assert 'When the battery runs low' in shown and 'gyro, wheels, camera, battery_state.voltage' in shown
    assert main([*shlex.split(simulate)[1:], '--duration', '60']) == 0
    assert 'with low_supply: k = 0.1 1/V' in capsys.readouterr().out
    assert main([*shlex.split(replay)[1:], '--json']) == 0
    found = json.loads(capsys.readouterr().out)['coefficients']['low_supply']
    assert found['value'] == pytest.approx(0.1, abs=3.0 * found['std'])
    assert found['std'] < 0.02
    assert main([*shlex.split(diagnose)[1:], '--json']) == 0
    diagnosis = json.loads(capsys.readouterr().out)
    assert [item['effect'] for item in diagnosis['missing']] == ['low_supply']
    assert 'low_supply' not in diagnosis['not_judged']


def test_the_entry_point_of_the_guide_names_the_group() -> None:
    (toml,) = blocks_of_the_guide('toml')
    assert f"[project.entry-points.'{registry.ENTRY_POINTS}']" in toml


def test_a_file_is_loaded_once(write: Write) -> None:
    file = write(EFFECT)
    first = load_file(file)
    assert [effect.name for effect in first] == ['mine']
    assert load_file(file) == first
    assert find_effect('mine') is first[0]


def test_private_classes_in_a_file_are_no_effects(write: Write) -> None:
    code = EFFECT + textwrap.dedent("""
        class _Hidden(Mine):
            name: str = 'hidden'

        class Other:
            pass
    """)
    assert [effect.name for effect in load_file(write(code))] == ['mine']


def changed(old: str, new: str) -> str:
    assert old in EFFECT
    return EFFECT.replace(old, new)


WRONG = {
    'empty': ('', 'defines no effect'),
    'syntax': ('def', 'SyntaxError'),
    'exit': ('raise SystemExit(7)', 'SystemExit: 7'),
    'import': ('import not_there_at_all', 'ModuleNotFoundError'),
    'taken': (changed("'mine'", "'gyro_lag'"), "there is an effect 'gyro_lag' already"),
    'name': (changed("'mine'", "'My Effect'"), 'name is'),
    'place': (changed('    name:', "    acts_on = 'engine'\n    name:"), "acts_on is 'engine'"),
    'camera': (changed('    name:', "    acts_on = 'camera'\n    name:"), 'lacks corrected'),
    'coefficients': (changed("(Coefficient('k', 'rad/s', 0.1),)", '()'), 'coefficients is no tuple'),
    'twice': (changed("0.1),)", "0.1),) * 2"), 'two coefficients have the same name'),
    'no dataclass': (changed('@dataclass(frozen=True)\n', ''), 'is no dataclass'),
    'arguments': (changed("str = 'mine'", 'str'), 'cannot be made without arguments'),
    'no words': (changed("'w = w_n + k'", "''"), 'about says nothing of equation'),
    'about': (re.sub(r'= Explanation\(.*', "= 'It is.'", EFFECT), 'about is no Explanation'),
    'example': (changed('(0.1,)', '(0.1, 0.2)'), 'about.example has 2 values for 1 coefficients'),
    'shape': (changed('column(np.ones(len(block.dt_s)))', 'np.ones(len(block.dt_s))'), 'contribute'),
    'signal': (changed('column(np.ones(len(block.dt_s)))', "column(block.covariates['x'])"), "KeyError: 'x'"),
    'nan': (changed('np.ones(len(block.dt_s))', 'block.temperature_c'), 'where no temperature is recorded'),
    'no pose': (changed('np.ones(len(block.dt_s))', 'block.position_m[:, 0]'), 'contribute fails: TypeError'),
    'needs': (changed('example=', "needs=('fan.data'), example="), "about.needs is 'fan.data', not a tuple"),
    'stimulus': (changed('example=', "shown_against='sun', example="), "about.shown_against is 'sun'"),
    'no signal': (changed('example=', "shown_against='signal', example="), 'takes one signal in about.needs'),
}  # fmt: skip


@pytest.mark.parametrize('case', WRONG)
def test_the_fault_of_a_file_is_reported(case: str, write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    code, message = WRONG[case]
    file = write(code)
    assert main(['effects', '--effects-from', str(file)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert str(file) in error
    assert error.count('\n') == 1
    assert 'mine' not in EFFECTS
    assert main(['effects', '--effects-from', str(file)]) == 2, 'and reported again'


def test_a_wrong_derivative_is_found(write: Write) -> None:
    code = EFFECT + textwrap.dedent("""
            def contribute(self, block, values, memory):
                columns = self.columns(block)
                return GyroTerm(values[0] ** 2 * columns[:, 0], columns)
    """).replace('\n', '\n    ')
    with pytest.raises(ConfigError, match='wrong derivative by k'):
        load_file(write(code))


SCANNED = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.sensor import Coefficient, GyroTerm

@dataclass(frozen=True)
class Fading:
    about: ClassVar[Explanation] = Explanation('It is.', 'w = ...', 'small', 'none', example=(0.1, 20.0))
    acts_on: ClassVar[str] = 'gyro'
    name: str = 'fading'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient('k', 'rad/s', 0.1),
        Coefficient('tau', 's', 10.0, prior_mean=20.0, scan=(10.0, 20.0, 40.0)),
    )

    def contribute(self, block, values, memory):
        decay = np.exp(-block.time_s / values[1])
        by_tau = values[0] * decay * block.time_s / values[1] ** 2
        return GyroTerm(values[0] * decay, np.stack([decay, by_tau], axis=1))

    def columns_at(self, block, scan, memory):
        return np.exp(-block.time_s[:, None] / scan), None
"""

LIMIT = """
    def detect(self, readings):
        return None

    def rate_error(self, rate_rad_s, limit):
        return rate_rad_s, rate_rad_s

    def is_plausible(self, readings, limit):
        return True
"""


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('10.0, 20.0, 40.0', '20.0, 10.0, 40.0', 'the scan of tau is not 3 or more positive, increasing'),
        ('10.0, 20.0, 40.0', '0.0, 20.0, 40.0', 'the scan of tau is not 3 or more positive, increasing'),
        ('10.0, 20.0, 40.0', '10.0, 20.0', 'the scan of tau is not 3 or more positive, increasing'),
        ("'rad/s', 0.1)", "'rad/s', 0.1, scan=(1.0, 2.0, 3.0))", 'k and tau have a scan; only one'),
        ("= 'gyro'", "= 'wheels'", 'tau has a scan; only effects on the gyro may'),
        (
            'values[0] * decay',
            '(1 + values[0]) * decay',
            'not zero where all but tau are',
        ),
        ('np.exp(-block.time_s[:, None]', 'np.exp(block.time_s[:, None]', 'columns_at differs from'),
        ('[:, None] / scan), None', '[:, None] / scan[:2]), None', 'columns_at differs from'),
        (
            '    def columns_at',
            f'{LIMIT}    def columns_at',
            'is a limit, which acts on the gyro and has one',
        ),
    ],
)
def test_the_fault_of_a_scan_is_reported(write: Write, old: str, new: str, message: str) -> None:
    assert old in SCANNED
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_file(write(SCANNED.replace(old, new)))
    assert 'fading' not in EFFECTS


def test_an_effect_with_a_scan_is_complete(write: Write) -> None:
    assert [effect.name for effect in load_file(write(SCANNED))] == ['fading']


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='is no Python file'):
        load_file(tmp_path / 'none.py')


def test_installed_effects_are_found(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(write(EFFECT).parent)
    point = EntryPoint('mine', 'my_effects:Mine', registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, 'entry_points', lambda group: [point])
    assert find_effect('mine').about.physics == 'It is.'
    registry.load_installed()


def test_an_installed_effect_that_cannot_be_loaded_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint('mine', 'not_there_at_all:Mine', registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, 'entry_points', lambda group: [point])
    with pytest.raises(ConfigError, match='entry point not_there_at_all:Mine: cannot be loaded'):
        find_effect('mine')


def test_columns_may_be_changed_without_changing_the_signal() -> None:
    signal = np.array([1.0, 2.0, 3.0])
    columns = column(signal)
    columns -= 1.0
    np.testing.assert_array_equal(columns[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(signal, [1.0, 2.0, 3.0])
