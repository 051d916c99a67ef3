"""The package as built and launched by a user, with all nodes together."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
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
"""Length of the sample bag that is played: with a turn, so that the scale factor converges."""
WITHIN_S = 120.0
INTERRUPTED = """
import os, signal, sys
from launch import LaunchService
from gyrocal_ros.nodes.launching import describe

def act(arguments):
    os.kill(os.getpid(), signal.SIGINT)
    print('it went on')
    return []

service = LaunchService()
service.include_launch_description(describe({}, act))
sys.exit(service.run(shutdown_when_idle=False))
"""
"""A launch that is interrupted while it is busy."""


@pytest.fixture(scope='session')
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build and install the package as in the workspace of a user."""
    if shutil.which('colcon') is None:
        pytest.skip('colcon is missing')
    workspace = tmp_path_factory.mktemp('workspace')
    command = ['colcon', 'build', '--base-paths', str(PROJECT), '--packages-select', 'gyrocal_ros']
    built = subprocess.run(command, cwd=workspace, env=without_work_tree(), capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return workspace / 'install'


def without_work_tree() -> dict[str, str]:
    """Return the environment without the source code on the path of Python."""
    path = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(item for item in path if item != str(PROJECT))}


def hear_interrupts() -> None:
    """End the inheritance of an ignored SIGINT: a shell gives it to what it starts in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Launched:
    """A running launch file."""

    def __init__(self, installed: Path, domain: int, arguments: list[str], log: IO[str]) -> None:
        script = f'source {installed}/setup.bash && exec ros2 launch gyrocal_ros "$@"'
        self._log = log
        self.process = subprocess.Popen(
            ['bash', '-c', script, 'launch', *arguments],
            env={**without_work_tree(), 'ROS_DOMAIN_ID': str(domain)},
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # so that all its processes can be killed
            preexec_fn=hear_interrupts,
        )

    @property
    def output(self) -> str:
        self._log.seek(0)
        return self._log.read()

    def kill(self) -> None:
        """End the launch, and thereby all processes that it started, with one interrupt."""
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
    """Return a function that starts a launch file of the installed package in the graph of the test."""
    running = []

    def start(file: str, **arguments: object) -> Launched:
        given = [f'{name}:={value}' for name, value in arguments.items()]
        log = (tmp_path / f'{file}.log').open('w+')
        running.append(Launched(installed, graph.domain, [f'{file}.launch.py', *given], log))
        return running[-1]

    yield start
    for item in running:
        item.kill()
        print(item.output)


def wait_for_end(graph: Graph, launched: Launched) -> None:
    graph.wait(lambda: launched.process.poll() is not None, 'the end of the launch', WITHIN_S)
    assert launched.process.returncode == 0
    assert 'process has died' not in launched.output


def names_in(health: list[DiagnosticArray]) -> set[str]:
    return {status.name for array in health for status in array.status}


@pytest.fixture(scope='session')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the start of the sample bag."""
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
    """Return the calibration of the same recording without ROS."""
    config = Config()
    return conclude(calibrate(open_bag(bag, config), config, default_model()))


def test_a_recording_through_the_nodes_gives_the_result_of_its_replay(
    launch: Launch, graph: Graph, bag: Path, replayed: Calibration, tmp_path: Path
) -> None:
    path = tmp_path / 'calibration.yaml'
    launched = launch('replay', bag=bag, calibration=path, rate=0.5)
    wait_for_end(graph, launched)
    live = load_calibration(path)
    assert live.converged
    assert abs(live.scale_factor - replayed.scale_factor) < 0.2 * replayed.scale_factor_std
    assert live.scale_factor_std == pytest.approx(replayed.scale_factor_std, rel=0.05)


def test_an_emulated_robot_runs_until_the_end_of_its_drive(launch: Launch, graph: Graph) -> None:
    samples, features = graph.listen(Imu, 'imu/data'), graph.listen(PointCloud2, 'ceiling_camera/features')
    health = graph.listen(DiagnosticArray, '/diagnostics')
    launched = launch('emulated', scenario='demo', duration=6)
    graph.wait(lambda: samples and features and features[-1].width == 15, 'the robot to drive', WITHIN_S)
    wait_for_end(graph, launched)
    assert names_in(health) >= {'driver', 'tracker', 'calibrator', 'ceiling_emulator'}


def test_a_robot_starts_in_its_namespace_and_a_killed_node_is_restarted(
    launch: Launch, graph: Graph, tmp_path: Path
) -> None:
    health = graph.listen(DiagnosticArray, '/diagnostics')
    launched = launch('robot', namespace='robot1', port=tmp_path / 'none')
    nodes = {'robot1/driver', 'robot1/tracker', 'robot1/calibrator'}
    graph.wait(lambda: names_in(health) == nodes, 'all nodes', WITHIN_S)
    assert any(str(tmp_path / 'none') in status.message for array in health for status in array.status)
    (first,) = pids_of(launched, 'calibrator')
    os.kill(first, signal.SIGKILL)
    graph.wait(lambda: len(pids_of(launched, 'calibrator')) == 2, 'the restart of the calibrator', WITHIN_S)
    health.clear()  # what the killed process had published
    graph.wait(lambda: 'robot1/calibrator' in names_in(health), 'the restarted calibrator', WITHIN_S)


def pids_of(launched: Launched, name: str) -> list[int]:
    """Return the process ids that a node has had, from the output of the launch."""
    started = re.findall(rf'\[{name}-\d+\]: process started with pid \[(\d+)\]', launched.output)
    return [int(pid) for pid in started]


def test_an_interrupt_never_stops_launch_in_the_middle_of_its_work() -> None:
    """KeyboardInterrupt there would make launch wait forever for a process that it was about to start."""
    path = os.pathsep.join([str(PROJECT), os.environ.get('PYTHONPATH', '')])
    command, environment = [sys.executable, '-c', INTERRUPTED], {**os.environ, 'PYTHONPATH': path}
    result = subprocess.run(
        command,
        env=environment,
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        preexec_fn=hear_interrupts,
    )
    assert 'it went on' in result.stdout
    assert 'user interrupted' in result.stdout + result.stderr
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize('file', ['robot', 'replay', 'emulated'])
def test_every_argument_is_described(installed: Path, file: str) -> None:
    script = f'source {installed}/setup.bash && ros2 launch gyrocal_ros {file}.launch.py --show-args'
    result = subprocess.run(['bash', '-c', script], env=without_work_tree(), capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    lines = [line.strip() for line in result.stdout.splitlines() if line.strip()]
    arguments = [number for number, line in enumerate(lines) if line.startswith("'")]
    assert len(arguments) >= 6
    for number in arguments:
        assert lines[number + 1] not in ('', 'No description given'), lines[number]


def test_a_missing_recording_is_reported(launch: Launch, graph: Graph, tmp_path: Path) -> None:
    launched = launch('replay', bag=tmp_path / 'none')
    end_s = time.monotonic() + WITHIN_S
    while launched.process.poll() is None and time.monotonic() < end_s:
        graph.spin()
    assert launched.process.returncode == 1
    assert 'no such bag' in launched.output
