"""Every command that a page or a help text recommends is executed, on recordings of some seconds.

The commands of a page run in one folder, in order, so that a later one may use what an earlier one wrote.
What a page takes for granted (`my_bag`, `model.yaml`) is there at the start. Commands that measure for hours,
reproduce the paper or serve a page have tests of their own.
"""

from __future__ import annotations

import argparse
import importlib
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_docs import PAGES, ROOT, commands

from gyrocal_ros.cli.main import COMMANDS, command_parser, main
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import shipped

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('library', 'slow_sensors')]

ELSEWHERE = {'bench', 'reproduce', 'studio', 'demo', 'fleet'}
"""Commands that other tests execute."""
FEATURES_S, IMAGES_S = '24', '1'
"""Length of a simulated recording."""
CANNOT_DRAW = 'figures cannot be drawn as PNG'
"""The error on a machine without kaleido, or without a browser that it can use."""
PLACEHOLDERS = {'NAME': 'gyro_lag', 'xsens.bag': 'my_bag'}
GUIDE = (ROOT / 'docs/your_own_effect.md').read_text(encoding='utf-8')
EXECUTED: set[tuple[str, ...]] = set()
"""Commands of the pages up to now."""
OWN_EFFECT = re.findall(r'```python\n(.*?)```', GUIDE, re.DOTALL)[0]
OWN_MODEL = re.findall(r'```yaml\n(.*?)```', GUIDE, re.DOTALL)[0]


@pytest.fixture(scope='module')
def prepared(tmp_path_factory: pytest.TempPathFactory, slow_sensors: None) -> Path:
    """What the pages take for granted: recordings with every topic of a robot, models and results."""
    folder = tmp_path_factory.mktemp('prepared')
    bag, result = folder / 'my_bag', folder / 'result'
    assert main(['simulate', str(bag), '--duration', FEATURES_S]) == 0
    assert main(['replay', str(bag), '-o', str(result)]) == 0
    for name in ('improved', 'learned'):
        shutil.copytree(result, folder / name)
    shutil.copy(result / 'calibration.yaml', folder / 'prior.yaml')
    for name in ('default.yaml', 'model.yaml'):
        shutil.copy(shipped('config/model.yaml'), folder / name)
    for name in ('my_effects.py', 'ripple.py', 'heat.py'):
        # One page has two files, whose effects need names of their own.
        (folder / name).write_text(OWN_EFFECT.replace('low_supply', 'heat') if 'heat' in name else OWN_EFFECT)
    return folder


@pytest.fixture
def folder(tmp_path: Path, prepared: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the prepared folder as the working directory."""
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def runnable(text: str) -> Iterator[list[str]]:
    """Yield the arguments of the complete commands of a page, each once."""
    seen, fleets = set(), set[str]()
    for command in commands(text):
        arguments = shlex.split(command, comments=True)
        is_new = tuple(arguments) not in seen
        seen.add(tuple(arguments))
        if '--fleet' in arguments:
            fleets.add(arguments[1])
        is_elsewhere = arguments[0] in ELSEWHERE or {'--help', '--fleet', *fleets} & set(arguments)
        if is_new and not is_elsewhere and is_complete(arguments):
            yield arguments


def is_complete(arguments: list[str]) -> bool:
    """Return False for the mere name of a command that needs arguments."""
    try:
        command_parser(arguments[0]).parse_args(arguments[1:])
    except GyrocalError:
        return len(arguments) > 1
    return True


def shortened(arguments: list[str]) -> list[str]:
    """Return the arguments for a short recording, with leave to overwrite results of earlier commands."""
    args = command_parser(arguments[0]).parse_args(arguments[1:])
    provide_recordings(args)
    if arguments[0] == 'simulate':
        arguments = [*arguments, '--duration', IMAGES_S if args.images else FEATURES_S]
        arguments += ['--fleet', '2', '--bags', '1'] if args.fleet else []
    written = [vars(args).get(name) for name in ('out', 'as_effect')]
    is_there = any(isinstance(path, Path) and path.exists() for path in written)
    return [*arguments, *(['--overwrite'] if is_there and '--overwrite' not in arguments else [])]


def provide_recordings(args: argparse.Namespace) -> None:
    """Provide the recording and the earlier calibration that a page takes for granted."""
    bag, start_from = vars(args).get('bag'), vars(args).get('start_from')
    if isinstance(bag, Path) and not bag.exists():
        shutil.copytree('my_bag', bag)
    if start_from is not None and not start_from.exists():
        shutil.copy('result/calibration.yaml', start_from)


def with_recorded_topics(arguments: list[str]) -> list[str]:
    """Name the topics that the stand-in for a recording of others has."""
    names = {'--heading-reference': 'wheel/odometry', '-r': 'imu/data_raw:=/imu/data_raw'}
    pairs = zip(['', *arguments], arguments, strict=False)
    return [names.get(option, word) for option, word in pairs]


def only_reads(arguments: list[str]) -> bool:
    """Return True for a command that reads `my_bag` and no other file, and writes none."""
    named = {'my_bag', '--json', '--help'} | {word for word in arguments if word.isidentifier()}
    return arguments[1:2] == ['my_bag'] and set(arguments) <= named


def execute(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Execute a command, unless it only reads `my_bag` and was executed for another page."""
    if only_reads(arguments) and tuple(arguments) in EXECUTED:
        return
    EXECUTED.add(tuple(arguments))
    arguments = shortened([PLACEHOLDERS.get(word, word) for word in arguments])
    if '--heading-reference' in arguments:
        arguments = with_recorded_topics(arguments)
    status = main(arguments)
    printed = capsys.readouterr()
    if status and '--png' in arguments and CANNOT_DRAW in printed.err:
        status = main([word for word in arguments if word != '--png'])
        printed = capsys.readouterr()
    assert status == 0, (shlex.join(['gyrocal', *arguments]), printed.err)
    assert printed.out


PAGES_WITH_COMMANDS = [page for page in PAGES if any(runnable(page.read_text(encoding='utf-8')))]


@pytest.mark.parametrize('page', PAGES_WITH_COMMANDS, ids=lambda page: page.name)
def test_the_commands_of_a_page_work(page: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if page.name == 'your_own_effect.md':
        (folder / 'model.yaml').write_text(OWN_MODEL)
    capsys.readouterr()
    for arguments in runnable(page.read_text(encoding='utf-8')):
        execute(arguments, capsys)


@pytest.mark.parametrize('name', sorted(COMMANDS.keys() - ELSEWHERE))
def test_the_examples_of_a_command_work(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / 'my_effects.py').write_text(OWN_EFFECT.replace("'low_supply'", "'my_effect'"))
    capsys.readouterr()
    example: str = importlib.import_module(f'gyrocal_ros.cli.{name}').EXAMPLE
    for line in example.splitlines():
        execute(shlex.split(line)[1:], capsys)


def test_arguments_are_shortened(folder: Path) -> None:
    assert shortened(['simulate', 'new', '--duration', '300'])[-2:] == ['--duration', FEATURES_S]
    assert shortened(['replay', 'my_bag', '-o', 'result'])[-1] == '--overwrite'
    assert isinstance(command_parser('replay'), argparse.ArgumentParser)
