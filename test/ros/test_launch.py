"""The package as it is built and launched: all nodes together, as a user starts them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import PROJECT, Graph
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import Imu, PointCloud2

from gyrocal_ros.bag.source import open_bag
from gyrocal_ros.bag.storage import open_storage, ros_types
from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.effects import default_model
from gyrocal_ros.files import shipped
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import Calibration, conclude, load_calibration

PLAYED_S = 12.0
"""So much of the sample bag has a turn in it, and the scale factor converges."""
WITHIN_S = 120.0


@pytest.fixture(scope='session')
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package, built and installed as in a workspace of a user."""
    if shutil.which('colcon') is None:
        pytest.skip('colcon is missing: nothing can be built')
    workspace = tmp_path_factory.mktemp('workspace')
    command = ['colcon', 'build', '--base-paths', str(PROJECT), '--packages-select', 'gyrocal_ros']
    built = subprocess.run(command, cwd=workspace, env=without_work_tree(), capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return workspace / 'install'


def without_work_tree() -> dict[str, str]:
    """The environment of a user who has no source code on the path of Python."""
    path = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(item for item in path if item != str(PROJECT))}


class Launched:
    """A launch file that runs."""

    def __init__(self, installed: Path, domain: int, arguments: list[str], log: IO[str]) -> None:
        script = f'source {installed}/setup.bash && exec ros2 launch gyrocal_ros "$@"'
        self._log = log
        self.process = subprocess.Popen(
            ['bash', '-c', script, 'launch', *arguments],
            env={**without_work_tree(), 'ROS_DOMAIN_ID': str(domain)},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # so that nothing of it is left over
        )

    @property
    def said(self) -> str:
        self._log.seek(0)
        return self._log.read()

    def kill(self) -> None:
        """End it and all that it started."""
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(WITHIN_S)
        finally:
            if self.process.poll() is None:
                os.killpg(self.process.pid, signal.SIGKILL)


Launch = Callable[..., Launched]


@pytest.fixture
def graph() -> Iterator[Graph]:
    with Graph() as graph:
        yield graph


@pytest.fixture
def launch(installed: Path, graph: Graph, tmp_path: Path) -> Iterator[Launch]:
    """Start a launch file of the installed package in the graph of the test."""
    running = []

    def start(file: str, **arguments: object) -> Launched:
        given = [f'{name}:={value}' for name, value in arguments.items()]
        log = (tmp_path / f'{file}.log').open('w+')
        running.append(Launched(installed, graph.domain, [f'{file}.launch.py', *given], log))
        return running[-1]

    yield start
    for item in running:
        item.kill()
        print(item.said)


def wait_for_end(graph: Graph, launched: Launched) -> None:
    graph.wait(lambda: launched.process.poll() is not None, 'its end', WITHIN_S)
    assert launched.process.returncode == 0
    assert 'process has died' not in launched.said


def names_in(health: list[DiagnosticArray]) -> set[str]:
    return {status.name for array in health for status in array.status}


@pytest.fixture(scope='session')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The start of the sample bag."""
    path = tmp_path_factory.mktemp('bags') / 'start'
    with (
        open_storage(shipped('bags/demo')) as storage,
        Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        connections = {
            name: writer.add_connection(name, topic.type_name, typestore=ros_types())
            for name, topic in storage.topics.items()
        }
        for name, recorded_ns, raw in storage.raw_messages(storage.topics.values()):
            if recorded_ns <= storage.start_ns + PLAYED_S * NS_PER_S:
                writer.write(connections[name], recorded_ns, raw)
    return path


@pytest.fixture(scope='session')
def replayed(bag: Path) -> Calibration:
    """What the same recording tells without ROS."""
    config = Config()
    return conclude(calibrate(open_bag(bag, config), config, default_model()))


def test_a_recording_through_the_nodes_ends_as_its_replay_does(
    launch: Launch, graph: Graph, bag: Path, replayed: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / 'calibration.yaml'
    launched = launch('replay', bag=bag, calibration=path, rate=0.5)
    wait_for_end(graph, launched)
    live = load_calibration(path)
    assert live.converged
    assert abs(live.scale_factor - replayed.scale_factor) < 0.2 * replayed.scale_factor_std
    assert live.scale_factor_std == pytest.approx(replayed.scale_factor_std, rel=0.05)


def test_an_emulated_robot_runs_and_comes_to_its_end(launch: Launch, graph: Graph) -> None:
    samples, features = graph.listen(Imu, 'imu/data'), graph.listen(PointCloud2, 'ceiling_camera/features')
    health = graph.listen(DiagnosticArray, '/diagnostics')
    launched = launch('emulated', scenario='demo', duration=6)
    graph.wait(lambda: samples and features and features[-1].width == 15, 'the robot to drive', WITHIN_S)
    wait_for_end(graph, launched)
    assert names_in(health) >= {'driver', 'tracker', 'calibrator', 'ceiling_emulator'}


def test_a_robot_starts_in_its_namespace_and_a_node_that_dies_comes_again(
    launch: Launch, graph: Graph, tmp_path: Path
) -> None:
    health = graph.listen(DiagnosticArray, '/diagnostics')
    launched = launch('robot', namespace='robot1', port=tmp_path / 'none')
    nodes = {'robot1/driver', 'robot1/tracker', 'robot1/calibrator'}
    graph.wait(lambda: names_in(health) == nodes, 'all nodes', WITHIN_S)
    assert any(str(tmp_path / 'none') in status.message for array in health for status in array.status)
    os.kill(pid_of(launched, 'calibrator'), signal.SIGKILL)
    graph.wait(
        lambda: launched.said.count('[calibrator') and 'process has died' in launched.said, 'its death'
    )
    health.clear()
    graph.wait(lambda: 'robot1/calibrator' in names_in(health), 'the calibrator to come again', WITHIN_S)


def pid_of(launched: Launched, name: str) -> int:
    """Process id of a node, as the launch tells it."""
    line = next(
        line for line in launched.said.splitlines() if f'[{name}' in line and 'started with pid' in line
    )
    return int(line.rpartition('pid [')[2].rstrip(']'))


@pytest.mark.parametrize('file', ['robot', 'replay', 'emulated'])
def test_every_argument_is_described(installed: Path, file: str) -> None:
    script = f'source {installed}/setup.bash && ros2 launch gyrocal_ros {file}.launch.py --show-args'
    shown = subprocess.run(['bash', '-c', script], env=without_work_tree(), capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr
    lines = [line.strip() for line in shown.stdout.splitlines() if line.strip()]
    arguments = [number for number, line in enumerate(lines) if line.startswith("'")]
    assert len(arguments) >= 6
    for number in arguments:
        assert lines[number + 1] not in ('', 'No description given'), lines[number]


def test_a_wrong_recording_is_told_in_one_line(launch: Launch, graph: Graph, tmp_path: Path) -> None:
    launched = launch('replay', bag=tmp_path / 'none')
    end_s = time.monotonic() + WITHIN_S
    while launched.process.poll() is None and time.monotonic() < end_s:
        graph.spin()
    assert launched.process.returncode == 1
    assert 'no such bag' in launched.said
