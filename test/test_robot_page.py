"""The page about the robot quotes messages that the code produces, and names what exists."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from gyrocal_ros.config.declare import flat_settings
from gyrocal_ros.config.robot_sections import RobotConfig
from gyrocal_ros.config.sections import Config

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / 'docs' / 'robot.md').read_text(encoding='utf-8')
SOURCES = [
    *(ROOT / 'gyrocal_ros' / 'robot').glob('*.py'),
    ROOT / 'gyrocal_ros' / 'board' / 'link.py',
    ROOT / 'gyrocal_ros' / 'ekf' / 'watches' / 'camera_faults.py',
    ROOT / 'gyrocal_ros' / 'ekf' / 'watches' / 'law_watch.py',
    ROOT / 'gyrocal_ros' / 'ekf' / 'noise' / 'noise_bank.py',
    ROOT / 'gyrocal_ros' / 'ekf' / 'features' / 'way_agreement.py',
    ROOT / 'gyrocal_ros' / 'model' / 'faulty_readings.py',
    ROOT / 'gyrocal_ros' / 'msgs' / 'mounts.py',
    ROOT / 'gyrocal_ros' / 'nodes' / 'qos_watch.py',
    ROOT / 'gyrocal_ros' / 'vision' / 'tracker.py',
    ROOT / 'gyrocal_ros' / 'vision' / 'dirty_lens.py',
]
MIN_LETTERS = 10
"""Minimum number of literal letters by which a string of the code is recognised in a message."""


def pattern(node: ast.AST) -> str:
    """Regular expression of the text that a string of the code produces."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.escape(node.value.replace('`', ''))
    if isinstance(node, ast.JoinedStr):
        return ''.join(pattern(part) for part in node.values)
    return '.*'


@cache
def produced() -> list[re.Pattern[str]]:
    """Patterns of all strings of the code that words health messages, the longest first."""
    trees = [ast.walk(ast.parse(file.read_text(encoding='utf-8'))) for file in SOURCES]
    strings = (node for tree in trees for node in tree if isinstance(node, ast.JoinedStr | ast.Constant))
    patterns = {
        pattern(node) for node in strings if not isinstance(node, ast.Constant) or isinstance(node.value, str)
    }
    stripped = {item.removeprefix('.*').removesuffix('.*') for item in patterns}
    longest_first = sorted(stripped, key=len, reverse=True)
    return [re.compile(item) for item in longest_first if len(item.replace('.*', '')) >= MIN_LETTERS]


def quoted() -> Iterator[str]:
    """Yield the quoted messages: first column of the table of problems, second of that of healthy nodes."""
    healthy, _, problems = PAGE.partition('## Problems and their causes')
    for row in re.findall(r'^\| `([^`]+)` \|', problems, re.MULTILINE):
        yield row
    for row in re.findall(r'^\| (?:tracker|calibrator) \| `([^`]+)` \|', healthy, re.MULTILINE):
        yield row
    yield from re.findall(r'`(not converged yet[^`]+)`', healthy)


@pytest.mark.parametrize('message', list(quoted()))
def test_quoted_messages_are_produced(message: str) -> None:
    left = message
    for item in produced():
        left = item.sub('', left)
    words = [word for word in left.split() if '/' not in word]  # topics and ports are values
    assert not re.findall(r'[a-z]{4,}', ' '.join(words)), f'no code produces {words}'


def test_the_page_quotes_many_messages() -> None:
    assert len(list(quoted())) > 20
    assert not any(item.search('all is well with the whole robot') for item in produced())


def test_named_settings_exist() -> None:
    known = {name for config in (Config(), RobotConfig()) for name, _, _ in flat_settings(config)}
    sections = {name.partition('.')[0] for name in known}
    named = {name for name in re.findall(r'`([a-z]+\.[a-z_]+)`', PAGE) if name.partition('.')[0] in sections}
    assert len(named) >= 3
    assert named - {'gyro.converged', 'gyro.scale_factor'} <= known


def test_given_launch_arguments_exist() -> None:
    for file, given in re.findall(r'ros2 launch gyrocal_ros (\w+)\.launch\.py([^`\n]*)', PAGE):
        text = (ROOT / 'launch' / f'{file}.launch.py').read_text(encoding='utf-8')
        common = (ROOT / 'gyrocal_ros' / 'nodes' / 'launching.py').read_text(encoding='utf-8')
        for name in re.findall(r'(\w+):=', given):
            assert f"'{name}': (" in text or f"'{name}': (" in common, f'{file} has no argument {name}'


def test_named_services_exist() -> None:
    for node, service in re.findall(r'/(driver|calibrator)/(\w+)', PAGE):
        modules = (ROOT / 'gyrocal_ros' / 'nodes').glob(f'{node}*.py')
        assert any(f"'~/{service}'" in module.read_text(encoding='utf-8') for module in modules)


def test_the_example_in_python_can_be_parsed() -> None:
    (code,) = re.findall(r'^```python\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE)
    assert len(ast.parse(code).body) >= 8
    assert len([line for line in code.splitlines() if line.strip()]) <= 14
