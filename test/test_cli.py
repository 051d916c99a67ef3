"""The command line: help of each command, and errors in one line."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gyrocal_ros import __version__
from gyrocal_ros.cli.main import COMMANDS, main
from gyrocal_ros.cli.output import print_json
from gyrocal_ros.cli.replay import as_text
from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.files import shipped

Probe = Callable[[Callable[[], None]], None]


@pytest.fixture
def probe(monkeypatch: pytest.MonkeyPatch) -> Probe:
    """Register a command `probe` that calls a function of the test."""

    def register(work: Callable[[], None]) -> None:
        module = ModuleType('gyrocal_ros.cli.probe', 'Calls a function of the test.')
        vars(module).update(
            EXAMPLE='gyrocal probe --size 3',
            add_arguments=lambda parser: parser.add_argument('--size', type=int, help='how large'),
            run=lambda args: work(),
        )
        monkeypatch.setitem(COMMANDS, 'probe', 'calls a function')
        monkeypatch.setitem(sys.modules, module.__name__, module)

    return register


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match='0'):
        main(['--help'])
    shown = capsys.readouterr().out
    assert all(name in shown and meaning in shown for name, meaning in COMMANDS.items())


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match='0'):
        main(['--version'])
    assert capsys.readouterr().out == f'gyrocal {__version__}\n'


@pytest.mark.parametrize('name', COMMANDS)
def test_the_help_of_each_command_has_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match='0'):
        main([name, '--help'])
    description, _, example = capsys.readouterr().out.partition('example:')
    assert len(description) > 100
    assert f'gyrocal {name}' in example


@pytest.mark.parametrize('name', COMMANDS)
def test_each_command_refuses_an_unknown_option_in_one_line(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([name, '--no-such-option']) == 2
    assert one_error_line(capsys).endswith(f'see gyrocal {name} --help')


def test_without_arguments_the_commands_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert all(f'  {name} ' in shown for name in COMMANDS)


@pytest.mark.parametrize(
    ('arguments', 'suggestion'),
    [
        (['repaly'], 'did you mean gyrocal replay?'),
        (['replay', 'bag', '--ovewrite'], 'did you mean --overwrite?'),
        (['replay', 'bag', '--modle=m.yaml'], 'did you mean --model?'),
        (['bench', 'acuracy'], "did you mean 'accuracy'?"),
        (['effects', 'gyro_lagg'], "did you mean 'gyro_lag'?"),
    ],
)
def test_a_misspelt_name_gets_a_suggestion(
    arguments: list[str], suggestion: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert suggestion in one_error_line(capsys)


@pytest.mark.parametrize(
    ('arguments', 'bounds'),
    [
        (['studio', '--port', '70000'], 'a whole number, 0 to 65535'),
        (['studio', '--port', '80.5'], 'a whole number, 0 to 65535'),
        (['studio', '--lesson', '-1'], 'a whole number, at least 0'),
        (['simulate', 'bag', '--duration', 'nan'], '1 to 7200 s'),
        (['simulate', 'bag', '--seed', '-1'], 'at least 0'),
        (['simulate', 'bag', '--seed', '9' * 400], 'at least 0'),
        (['bench', '--seeds', '0'], 'at least 1'),
        (['reproduce', '--seeds', 'many'], 'at least 1'),
    ],
)
def test_a_number_out_of_bounds_is_refused(
    arguments: list[str], bounds: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    line = one_error_line(capsys)
    assert repr(arguments[-1]) in line and bounds in line


@pytest.mark.parametrize('arguments', [['repaly'], ['--loud'], ['qqq']])
def test_unknown_command_is_refused_in_one_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert one_error_line(capsys).endswith('see gyrocal --help')


def one_error_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the line on standard error, and check that nothing else was printed."""
    captured = capsys.readouterr()
    assert captured.out == ''
    (line,) = captured.err.splitlines()
    assert line.startswith('gyrocal: error: ')
    return line


def test_an_error_is_printed_in_one_line_with_status_2(
    probe: Probe, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise GyrocalError('holds no images', where='kitchen.bag', todo='record ceiling_camera/image_raw')

    probe(fail)
    assert main(['probe']) == 2
    assert one_error_line(capsys) == (
        'gyrocal: error: kitchen.bag: holds no images; record ceiling_camera/image_raw'
    )


def test_an_argument_of_the_wrong_type_is_refused(probe: Probe, capsys: pytest.CaptureFixture[str]) -> None:
    probe(lambda: pytest.fail('must not run'))
    assert main(['probe', '--size', 'large']) == 2
    assert "invalid int value: 'large'" in one_error_line(capsys)


def test_an_interruption_prints_no_traceback(probe: Probe, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    probe(interrupt)
    assert main(['probe']) == 130
    assert capsys.readouterr().err == 'gyrocal: interrupted\n'


def test_an_error_of_the_program_is_not_caught(probe: Probe) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    probe(fail)
    with pytest.raises(ZeroDivisionError):
        main(['probe'])


def test_json_is_one_valid_object(probe: Probe, capsys: pytest.CaptureFixture[str]) -> None:
    values = {
        'bias': np.float64(0.25),
        'unknown': float('nan'),
        'matrix': np.array([[1.0, np.inf]]),
        'converged': np.bool_(True),
        'coefficients': {'scale_cubic': {'value': 1e-3, 'unit': 's²/rad²'}},
        'missing': ({'effect': 'gyro_lag'},),
    }
    probe(lambda: print_json(values))
    assert main(['probe']) == 0
    assert json.loads(capsys.readouterr().out) == {
        'bias': 0.25,
        'unknown': None,
        'matrix': [[1.0, None]],
        'converged': True,
        'coefficients': {'scale_cubic': {'value': 1e-3, 'unit': 's²/rad²'}},
        'missing': [{'effect': 'gyro_lag'}],
    }


@pytest.mark.slow
def test_demo_finds_the_true_scale_factor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['demo', '--json']) == 0
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert captured.err == ''
    assert summary['converged']
    assert abs(summary['scale_factor'] - 135.5 / 146.4) < 3.0 * summary['scale_factor_std'] < 3e-4
    report = tmp_path / 'gyrocal_demo'
    assert {'calibration.yaml', 'report.html'} <= {file.name for file in report.iterdir()}
    assert [folder.name for folder in tmp_path.iterdir()] == ['gyrocal_demo']


@pytest.mark.parametrize(
    ('worst', 'text'), [(0.2, '0.20 deg in one span'), (0.3, '0.20 deg rms, 0.30 at worst')]
)
def test_the_drift_of_a_single_span_is_reported_as_such(worst: float, text: str) -> None:
    names = ('scale_factor', 'scale_factor_std', 'scale_factor_volt', 'bias', 'bias_std', 'heading_rms_deg')
    status = {'level': 'yellow', 'sentence': 'Not calibrated yet.', 'next_step': 'Record more turns.'}
    summary: dict[str, Any] = dict.fromkeys(names, 0.1) | {
        'coefficients': {},
        'converged': False,
        'convergence_time_s': None,
    }
    drift = {'rms': 0.2, 'max': worst, 'from_s': 10.0}
    printed = as_text(summary | {'status': status, 'blind_drift_deg': drift})
    late = summary | {'status': status, 'blind_drift_deg': drift, 'convergence_time_s': 17.0}
    assert 'before the gyro was calibrated' in as_text(late) and 'before the' not in printed
    assert text in as_text(late), 'the drift shows that the model does not fit'
    calibrated = as_text(late | {'converged': True, 'duration_s': 70.0})
    assert 'no 60 s are left after the gyro was calibrated' in calibrated and text not in calibrated
    assert text in printed and printed.startswith('[yellow] Not calibrated yet.')
    assert printed.endswith('Next: Record more turns.')


@pytest.mark.slow
def test_a_replay_from_a_calibration_uses_its_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, model, out = (str(tmp_path / name) for name in ('bag', 'model.yaml', 'out'))
    assert main(['simulate', bag, '--scenario', 'demo', '--duration', '20']) == 0
    assert main(['add', 'gyro_lag', '--model', model]) == 0
    assert main(['replay', bag, '--model', model, '-o', out]) == 0
    capsys.readouterr()
    assert main(['replay', bag, '--start-from', f'{out}/calibration.yaml', '--json']) == 0
    assert 'gyro_lag' in json.loads(capsys.readouterr().out)['coefficients']


def test_a_result_folder_that_is_not_empty_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'mine.txt').write_text('mine')
    assert main(['demo', '-o', str(tmp_path)]) == 2
    assert one_error_line(capsys).endswith('is not empty; choose another name or give --overwrite')


@pytest.mark.parametrize('command', ['check', 'replay'])
@pytest.mark.parametrize('case', ['missing', 'empty', 'truncated'])
def test_a_bag_that_cannot_be_read_is_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, case: str
) -> None:
    bag = tmp_path / 'bag'
    if case != 'missing':
        shutil.copytree(shipped('bags/cleaning'), bag)
        recording = bag / 'cleaning.mcap'
        recording.write_bytes(b'' if case == 'empty' else recording.read_bytes()[:100_000])
    before = sorted(tmp_path.rglob('*'))
    out = ['-o', str(tmp_path / 'out')] if command == 'replay' else []
    assert main([command, str(bag), *out]) == 2
    assert str(bag) in one_error_line(capsys)
    assert sorted(tmp_path.rglob('*')) == before


def test_help_imports_no_heavy_libraries() -> None:
    heavy = {'numpy', 'cv2', 'rosbags', 'plotly', 'scipy', 'yaml', 'tqdm'}
    code = f"""
import sys
from gyrocal_ros.cli.main import main
try:
    main(['--help'])
finally:
    print(sorted({heavy} & set(sys.modules)), file=sys.stderr)
"""
    done = run_python(code)
    assert (done.returncode, done.stderr) == (0, '[]\n')


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('gyrocal rep', {'replay', 'reproduce'}),
        ('gyrocal replay bag --over', {'--overwrite '}),
        ('gyrocal add gyro_l', {'gyro_lag '}),
        ('gyrocal simulate bag --scenario furn', {'furniture '}),
        ('gyrocal completion z', {'zsh '}),
    ],
)
def test_bash_completes_commands_options_and_names(line: str, expected: set[str], tmp_path: Path) -> None:
    answer = tmp_path / 'answer'
    code = 'import sys; from gyrocal_ros.cli.main import main; sys.exit(main())'
    asked = {'_ARGCOMPLETE': '1', 'COMP_LINE': line, 'COMP_POINT': str(len(line)), 'COMP_TYPE': '9'}
    settings = {'_ARGCOMPLETE_IFS': '\n', '_ARGCOMPLETE_STDOUT_FILENAME': str(answer)}
    subprocess.run([sys.executable, '-c', code], env=os.environ | asked | settings, timeout=60)
    assert set(answer.read_text().split('\n')) == expected


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
def test_the_code_of_a_shell_is_printed(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['completion', shell]) == 0
    code = capsys.readouterr().out
    assert 'gyrocal' in code and 'complete' in code


def test_the_end_of_the_reader_is_not_an_error() -> None:
    code = """
import sys
from types import ModuleType
from gyrocal_ros.cli import main
printer = ModuleType('gyrocal_ros.cli.printer')
printer.EXAMPLE, printer.add_arguments = '', lambda parser: None
printer.run = lambda args: [print('word ' * 1000) for _ in range(1000)]
sys.modules[printer.__name__] = printer
main.COMMANDS['printer'] = 'prints'
sys.exit(main.main(['printer']))
"""
    printer = subprocess.Popen(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert printer.stdout is not None and printer.stderr is not None
    printer.stdout.readline()
    printer.stdout.close()
    assert printer.stderr.read() == ''
    assert printer.wait(timeout=60) == 141
    printer.stderr.close()


@pytest.mark.skipif(sys.platform == 'win32', reason='needs a shell')
@pytest.mark.parametrize('closed', ['>&-', '2>&-', '<&- >&- 2>&-', '2>/dev/full'])
def test_closed_or_full_streams_change_neither_work_nor_status(closed: str) -> None:
    """What would go to standard error must not appear among the results either."""
    command = f'{sys.executable} -m gyrocal_ros.cli.main check no_such_bag {closed}'
    done = subprocess.run(command, shell=True, capture_output=True, timeout=60, check=False)
    assert done.returncode == 2 and done.stdout == b''
    version = f'{sys.executable} -m gyrocal_ros.cli.main effects {closed}'
    assert subprocess.run(version, shell=True, capture_output=True, timeout=60, check=False).returncode == 0


@pytest.mark.parametrize('arguments', [['simulate', '/', '--duration', '2'], ['reveal', '/']])
def test_the_root_is_no_name_of_a_bag(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert '/' in one_error_line(capsys)


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs /dev/full')
@pytest.mark.parametrize('arguments', [['effects'], ['effects', '--json']])
def test_a_full_disk_is_an_error_in_one_line(arguments: list[str]) -> None:
    command = [sys.executable, '-m', 'gyrocal_ros.cli.main', *arguments]
    with open('/dev/full', 'w', encoding='utf-8') as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False
        )
    assert done.returncode == 2
    assert done.stderr.startswith('gyrocal: error: ') and done.stderr.count('\n') == 1
    assert 'No space left on device' in done.stderr


def test_a_terminal_without_unicode_shows_a_substitute() -> None:
    code = """
import sys
from types import ModuleType
from gyrocal_ros.cli import main
printer = ModuleType('gyrocal_ros.cli.printer')
printer.EXAMPLE, printer.add_arguments = '', lambda parser: None
printer.run = lambda args: print('1 \u00b1 0.1 \u00b0C')
sys.modules[printer.__name__] = printer
main.COMMANDS['printer'] = 'prints'
sys.exit(main.main(['printer']))
"""
    environment = {**os.environ, 'PYTHONIOENCODING': 'ascii', 'PYTHONUTF8': '0'}
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b'1 ? 0.1 ?C\n', b'')


def test_arguments_reach_the_command(probe: Probe) -> None:
    seen: list[argparse.Namespace] = []
    probe(lambda: None)
    sys.modules['gyrocal_ros.cli.probe'].run = seen.append  # type: ignore[attr-defined]
    assert main(['probe', '--size', '3']) == 0
    assert seen[0].size == 3
