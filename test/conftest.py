"""Reports the tests that this machine skips: of the nodes without ROS, of the page without Chromium."""

from __future__ import annotations

import ast
import gc
import os
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

# The commands do the same: idle threads of the linear algebra loop, and take the processor from the tests.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
# Nor is every module compiled again by each worker and by each of the hundred commands that tests start.
os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
sys.dont_write_bytecode = False

ROS_TESTS = Path(__file__).parent / 'ros'
HAS_ROS = find_spec('rclpy') is not None
BROWSER_TESTS = Path(__file__).parent / 'browser'
CHROMIUM = next(filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None)
HAS_BROWSER = CHROMIUM is not None and find_spec('playwright') is not None

collect_ignore_glob = [*(['ros/*'] if not HAS_ROS else []), *(['browser/*'] if not HAS_BROWSER else [])]


def tests_in(folder: Path) -> int:
    """Return the number of tests in the modules of a folder."""
    return sum(
        isinstance(node, ast.FunctionDef) and node.name.startswith('test_')
        for module in folder.glob('test_*.py')
        for node in ast.walk(ast.parse(module.read_text(encoding='utf-8')))
    )


def pytest_collection_finish() -> None:
    """Let the garbage collector look at new objects alone, and less often: it took a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not HAS_ROS:
        terminalreporter.section('ROS')
        text = f'{tests_in(ROS_TESTS)} tests of the nodes SKIPPED: rclpy is missing'
        terminalreporter.write_line(text, yellow=True)
    from gyrocal_ros import kernels  # loads NumPy, which reads the setting above

    if not kernels.TWINS:
        terminalreporter.section('kernels')
        text = 'comparisons of the compiled kernels SKIPPED: they were not built'
        terminalreporter.write_line(text, yellow=True)
    if not HAS_BROWSER:
        missing = 'Chromium' if CHROMIUM is None else 'playwright'
        terminalreporter.section('browser')
        text = f'{tests_in(BROWSER_TESTS)} tests of the page SKIPPED: {missing} is missing'
        terminalreporter.write_line(text, yellow=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.parent in (ROS_TESTS, BROWSER_TESTS) or item.get_closest_marker('thorough'):
            item.add_marker(pytest.mark.slow)
    # The files with the most slow tests come first: none is left for one worker alone at the end.
    slow = Counter(item.path for item in items if item.get_closest_marker('slow'))
    items.sort(key=lambda item: -slow[item.path])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return one worker more than there are cores: some tests wait for a browser or an emulated robot."""
    return len(os.sched_getaffinity(0)) + 1


@pytest.fixture(scope='session')
def uneven_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with a hidden effect, see `studio_parts`."""
    from studio_parts import write_bag

    return write_bag(tmp_path_factory.mktemp('bags'))


@pytest.fixture(scope='session')
def strange_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a gyro with a law that the library lacks, see `studio_parts`."""
    from studio_parts import write_strange_bag

    return write_strange_bag(tmp_path_factory.mktemp('bags'))


@pytest.fixture
def library() -> Iterator[None]:
    """Restore the table of effects afterwards."""
    from gyrocal_ros.effects import EFFECTS

    before = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


@pytest.fixture(scope='module')
def slow_sensors() -> Iterator[None]:
    """Scenarios with few images and samples a second, so that a recording costs a third."""
    from gyrocal_ros.sim.image_scenes import SCENES
    from gyrocal_ros.sim.scenarios import SCENARIOS

    with pytest.MonkeyPatch.context() as patch:
        for name, scenario in SCENARIOS.items():
            patch.setitem(SCENARIOS, name, replace(scenario, imu_hz=100, camera_hz=5))
        for name, scene in SCENES.items():
            patch.setitem(SCENES, name, replace(scene, camera_hz=5))
        yield
