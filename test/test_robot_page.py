"""The page about the robot quotes sentences that the nodes really say, and names what there is."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from gyrocal_ros.config.declare import flat_settings
from gyrocal_ros.config.sections import Config, RobotConfig

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / 'docs' / 'robot.md').read_text(encoding='utf-8')
SPEAKERS = [
    *(ROOT / 'gyrocal_ros' / 'robot').glob('*.py'),
    ROOT / 'gyrocal_ros' / 'board' / 'link.py',
    ROOT / 'gyrocal_ros' / 'msgs' / 'mounts.py',
    ROOT / 'gyrocal_ros' / 'vision' / 'tracker.py',
]
TELLING = 10
"""So many letters of its own a sentence of the code needs to be recognised."""


def pattern(node: ast.AST) -> str:
    """What a string of the code looks like when it is said."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.escape(node.value.replace('`', ''))
    if isinstance(node, ast.JoinedStr):
        return ''.join(pattern(part) for part in node.values)
    return '.*'


@cache
def said() -> list[re.Pattern[str]]:
    """All sentences, and parts of such, of the code that tells of health."""
    trees = [ast.walk(ast.parse(file.read_text(encoding='utf-8'))) for file in SPEAKERS]
    strings = (node for tree in trees for node in tree if isinstance(node, ast.JoinedStr | ast.Constant))
    patterns = {
        pattern(node) for node in strings if not isinstance(node, ast.Constant) or isinstance(node.value, str)
    }
    telling = {item.removeprefix('.*').removesuffix('.*') for item in patterns}
    longest_first = sorted(telling, key=len, reverse=True)
    return [re.compile(item) for item in longest_first if len(item.replace('.*', '')) >= TELLING]


def quoted() -> Iterator[str]:
    """The sentences that the page quotes: first column of the last table, second of the one of good ones."""
    good, _, bad = PAGE.partition('## When it says something else')
    for row in re.findall(r'^\| `([^`]+)` \|', bad, re.MULTILINE):
        yield row
    for row in re.findall(r'^\| (?:tracker|calibrator) \| `([^`]+)` \|', good, re.MULTILINE):
        yield row
    yield from re.findall(r'`(not converged yet[^`]+)`', good)


@pytest.mark.parametrize('sentence', list(quoted()))
def test_quoted_sentences_are_said(sentence: str) -> None:
    left = sentence
    for item in said():
        left = item.sub('', left)
    words = [word for word in left.split() if '/' not in word]  # topics and ports are not said by heart
    assert not re.findall(r'[a-z]{4,}', ' '.join(words)), f'nobody says {words}'


def test_the_page_quotes_many() -> None:
    assert len(list(quoted())) > 20
    assert not any(item.search('all is well with the whole robot') for item in said())


def test_settings_that_are_named_exist() -> None:
    known = {name for config in (Config(), RobotConfig()) for name, _, _ in flat_settings(config)}
    sections = {name.partition('.')[0] for name in known}
    named = {name for name in re.findall(r'`([a-z]+\.[a-z_]+)`', PAGE) if name.partition('.')[0] in sections}
    assert len(named) >= 3
    assert named - {'gyro.converged', 'gyro.scale_factor'} <= known


def test_launch_arguments_that_are_given_exist() -> None:
    for file, given in re.findall(r'ros2 launch gyrocal_ros (\w+)\.launch\.py([^`\n]*)', PAGE):
        text = (ROOT / 'launch' / f'{file}.launch.py').read_text(encoding='utf-8')
        common = (ROOT / 'gyrocal_ros' / 'nodes' / 'launching.py').read_text(encoding='utf-8')
        for name in re.findall(r'(\w+):=', given):
            assert f"'{name}': (" in text or f"'{name}': (" in common, f'{file} has no argument {name}'


def test_services_that_are_named_exist() -> None:
    for node, service in re.findall(r'/(driver|calibrator)/(\w+)', PAGE):
        text = (ROOT / 'gyrocal_ros' / 'nodes' / f'{node}.py').read_text(encoding='utf-8')
        assert f"'~/{service}'" in text


def test_the_example_in_python_can_be_parsed() -> None:
    (code,) = re.findall(r'^```python\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE)
    assert len(ast.parse(code).body) >= 8
    assert len([line for line in code.splitlines() if line.strip()]) <= 14
