"""Says loudly how many tests of the nodes a machine without ROS leaves out."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

ROS_TESTS = Path(__file__).parent / 'ros'
HAS_ROS = find_spec('rclpy') is not None

collect_ignore_glob = [] if HAS_ROS else ['ros/*']


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not HAS_ROS:
        count = sum(
            isinstance(node, ast.FunctionDef) and node.name.startswith('test_')
            for module in ROS_TESTS.glob('test_*.py')
            for node in ast.walk(ast.parse(module.read_text(encoding='utf-8')))
        )
        terminalreporter.section('ROS')
        terminalreporter.write_line(f'{count} tests of the nodes SKIPPED: rclpy is missing', yellow=True)
