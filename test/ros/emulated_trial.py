"""Runs a trial of all nodes on an emulated robot, and prints its figures.

    python test/ros/emulated_trial.py --minutes 10
    python test/ros/emulated_trial.py --minutes 8 --faults

Board and camera are emulated, with 20 ms of arrival jitter on the serial line; the nodes are real. With
faults, the board is unplugged for 5 s, 5 % of its bytes are corrupted for 30 s, the camera stops for 60 s,
the calibrator is killed, and the computer's clock is 2 s ahead for half a minute (if libfaketime is
installed). Needs a sourced ROS. Not a test, because it runs in real time and its latencies depend on the
machine.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from graph import PROJECT, Graph, NodeProcess
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from sensor_msgs.msg import Image, Imu, PointCloud2

from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.msgs.topics import Role, stamp_ns
from gyrocal_ros.nodes.qos import LATCHED, SENSOR_IN
from gyrocal_ros.sim.scenarios import find_scenario

SCENARIO, IMU_HZ = 'cleaning', 200.0
READY_S, SETTLED_S, PERIOD_S = 20.0, 12.0, 15.0
BOARD_FAULTS = ('--fault', 'unplug@60+5', '--fault', 'noise@100+30=0.05')
CAMERA_FAULTS = 'off@160+60'
CLOCK_FAULT, CLOCK_FROM_S, CLOCK_TO_S = ' clock@300+30', 300.0, 330.0
KILLED_AT_S = 250.0
EMULATED_NICENESS = 5
SAVE_S = 10.0
FAKETIME = next(Path('/usr/lib').glob('*/faketime/libfaketimeMT.so.1'), None)
TICK = os.sysconf('SC_CLK_TCK')
LATENCIES = ((Role.IMU, 'imu/data'), (Role.IMAGE, Role.FEATURES))


@dataclass(frozen=True)
class Usage:
    """CPU time and memory of a process at a time."""

    at_s: float
    pid: int
    cpu_s: float
    memory_mb: float


def usage(pid: int, at_s: float) -> Usage:
    stat = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    memory = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{pid}/status').read_text())
    memory_mb = int(memory[1]) / 1024.0 if memory else math.nan
    return Usage(at_s, pid, (int(stat[11]) + int(stat[12])) / TICK, memory_mb)


class Monitor:
    """Subscribes to all topics that the figures need."""

    def __init__(self, graph: Graph, start_s: float) -> None:
        self.start_ns = round(start_s * NS_PER_S)
        self.arrival_s: dict[str, dict[int, float]] = defaultdict(dict)
        """Arrival times by topic and stamp."""
        self.messages: list[tuple[float, str, str, dict[str, str]]] = []
        """Time, node, message and numbers of all diagnostics."""
        self.calibration: dict[str, Any] = {}
        kinds = {Role.IMU: Imu, 'imu/data': Imu, Role.IMAGE: Image, Role.FEATURES: PointCloud2}
        for topic, kind in kinds.items():
            qos = SENSOR_IN if kind is Image else 1000
            graph.node.create_subscription(kind, topic, self._receiver(topic), qos)
        graph.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_health, 100)
        graph.node.create_subscription(ParameterEvent, 'gyro_calibration', self._on_calibration, LATCHED)

    def _receiver(self, topic: str) -> Any:
        arrival_s = self.arrival_s[topic]

        def receive(message: Any, info: Any) -> None:
            # Arrival in the middleware: this program may have been busy with another message.
            arrival_s.setdefault(stamp_ns(message), info['received_timestamp'] / NS_PER_S)

        return receive

    def _on_health(self, message: DiagnosticArray) -> None:
        at_s = time.time() - self.start_ns / NS_PER_S
        for status in message.status:
            numbers = {item.key: item.value for item in status.values}
            self.messages.append((at_s, status.name, status.message, numbers))

    def _on_calibration(self, message: ParameterEvent) -> None:
        self.calibration = {
            item.name: parameter_value_to_python(item.value) for item in message.changed_parameters
        }

    def latencies_ms(self, before: str, after: str) -> list[float]:
        first, then = self.arrival_s[before], self.arrival_s[after]
        return [1e3 * (arrival_s - first[t_ns]) for t_ns, arrival_s in then.items() if t_ns in first]


def print_calibration(monitor: Monitor) -> None:
    truth, found = find_scenario(SCENARIO).errors.scale_factor, monitor.calibration
    error, std = found['gyro.scale_factor'] - truth, found['gyro.scale_factor_std']
    print(
        f'scale factor {found["gyro.scale_factor"]:.6f} ± {std:.6f}, true {truth:.6f}: '
        f'{100.0 * error / truth:+.4f} %, {error / std:+.1f} sigma; converged: {found["gyro.converged"]}'
    )


def print_stamps(monitor: Monitor) -> None:
    """Print the errors of the stamps: the true times are multiples of the sample interval since the start."""
    stamps_ns = np.array(sorted(monitor.arrival_s[Role.IMU])) - monitor.start_ns
    number = np.round(stamps_ns * IMU_HZ / NS_PER_S).astype(int)
    off_ms = np.abs(stamps_ns - number * NS_PER_S / IMU_HZ) / 1e6
    settled = stamps_ns > SETTLED_S * NS_PER_S
    lost = number[-1] - number[0] + 1 - len(set(number.tolist()))
    print(
        f'{Role.IMU}: {len(number)} samples, {lost} missing; stamp errors {off_ms[settled].mean():.3f} ms '
        f'on average, {off_ms[settled].max():.3f} at worst after {SETTLED_S:.0f} s, '
        f'{off_ms[~settled].max():.2f} before'
    )


def print_latencies(monitor: Monitor) -> None:
    for before, after in LATENCIES:
        late_ms = np.array(monitor.latencies_ms(before, after))
        print(
            f'{before} to {after}: {len(late_ms)} of {len(monitor.arrival_s[before])}, median '
            f'{np.median(late_ms):.1f} ms, 99 % {np.quantile(late_ms, 0.99):.1f}, worst {late_ms.max():.1f}'
        )


def print_usage(used: dict[str, list[Usage]]) -> None:
    total = 0.0
    for name, rows in used.items():
        pairs = [(a, b) for a, b in zip(rows[2:], rows[3:], strict=False) if a.pid == b.pid]
        share = sum(b.cpu_s - a.cpu_s for a, b in pairs) / sum(b.at_s - a.at_s for a, b in pairs)
        total += share
        every = max(len(rows) // 10, 1)
        memory_mb = ' '.join(f'{row.memory_mb:.0f}' for row in rows[::every])
        print(f'{name}: {100.0 * share:.1f} % of a core; memory in MB: {memory_mb}')
    print(f'together: {100.0 * total:.1f} % of a core')


def print_health(monitor: Monitor) -> None:
    last: dict[str, str] = {}
    for at_s, name, text, _ in monitor.messages:
        kind = re.sub(r'[\d.]+', '#', text)
        if last.get(name) != kind:
            print(f'{at_s:7.1f} s {name}: {text}')
            last[name] = kind
    for name, numbers in {name: numbers for _, name, _, numbers in monitor.messages}.items():
        print(name, json.dumps(numbers))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--seed', type=int, default=5)
    parser.add_argument('--faults', action='store_true')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Graph() as graph:
        run(args, Path(folder), graph)


def start_board(
    port: Path, start_s: float, duration_s: float, seed: int, faults: Sequence[str] = (), **options: Any
) -> subprocess.Popen[str]:
    """Start the board emulator, with 20 ms of jitter."""
    given = ('--scenario', SCENARIO, '--seed', str(seed), '--duration', str(duration_s), '--jitter', '0.02')
    board = subprocess.Popen(
        [sys.executable, '-m', 'gyrocal_ros.cli.board_emulator', '--link', str(port), *given]
        + ['--start-at', str(start_s), *faults],
        env={**os.environ, 'PYTHONPATH': f'{PROJECT}{os.pathsep}{os.environ.get("PYTHONPATH", "")}'},
        text=True,
        **options,
    )
    be_considerate(board.pid)
    return board


def start_camera(
    graph: Graph, start_s: float, duration_s: float, seed: int, troubles: str, **more: Any
) -> NodeProcess:
    """Start the emulated camera of the same robot; further keywords are further parameters."""
    ceiling = {'scenario': SCENARIO, 'seed': seed, 'duration_s': duration_s, 'start_at': start_s}
    named = {f'ceiling.{name}': value for name, value in {**ceiling, 'troubles': troubles}.items()}
    camera = graph.start('ceiling_emulator', parameters={**named, **more})
    be_considerate(camera.pid)
    return camera


def be_considerate(pid: int) -> None:
    """Lower the priority of a process: emulated hardware would not load the computer of a robot."""
    os.setpriority(os.PRIO_PROCESS, pid, EMULATED_NICENESS)


def start_driver(graph: Graph, port: Path, clock: Path | None) -> NodeProcess:
    """Start the driver; a file, if one is given, sets the offset of its clock."""
    if clock is None:
        return graph.start('driver', parameters={'driver.port': str(port)})
    clock.write_text('+0')
    faked = {
        'LD_PRELOAD': str(FAKETIME),
        'FAKETIME_TIMESTAMP_FILE': str(clock),
        'FAKETIME_DONT_FAKE_MONOTONIC': '1',
        'FAKETIME_CACHE_DURATION': '1',
    }
    os.environ.update(faked)
    try:
        return graph.start('driver', parameters={'driver.port': str(port)})
    finally:
        for name in faked:
            del os.environ[name]


def start_calibrator(graph: Graph, saved: Path) -> NodeProcess:
    """Start the calibrator; it saves every ten seconds."""
    parameters = {
        'live.calibration': str(saved),
        'live.save_interval_s': SAVE_S,
        'camera.pixel_noise_px': TrackerConfig().noise_px,  # as in the launch files
    }
    return graph.start('calibrator', parameters=parameters)


def run(args: argparse.Namespace, folder: Path, graph: Graph) -> None:
    duration_s, port, saved = 60.0 * args.minutes, folder / 'board', folder / 'calibration.yaml'
    start_s = time.time() + READY_S
    faults = BOARD_FAULTS if args.faults else ()
    board = start_board(port, start_s, duration_s, args.seed, faults, stdin=subprocess.DEVNULL)
    clock = folder / 'clock'
    has_clock_fault = args.faults and FAKETIME is not None
    troubles = CAMERA_FAULTS * args.faults + CLOCK_FAULT * has_clock_fault
    start_camera(graph, start_s, duration_s, args.seed, troubles)
    nodes: dict[str, NodeProcess] = {
        'driver': start_driver(graph, port, clock if has_clock_fault else None),
        'tracker': graph.start('tracker'),
        'calibrator': start_calibrator(graph, saved),
    }
    monitor, used, next_s = Monitor(graph, start_s), defaultdict[str, list[Usage]](list), 0.0
    killed_at_s = KILLED_AT_S if args.faults else math.inf
    try:
        while (at_s := time.time() - start_s) < duration_s + 2.0:
            graph.spin(0.05)
            if at_s >= next_s:
                next_s += PERIOD_S
                for name, process in nodes.items():
                    used[name].append(usage(process.pid, at_s))
            clock.write_text('+2' if CLOCK_FROM_S <= at_s < CLOCK_TO_S else '+0')
            if at_s > killed_at_s:
                killed_at_s = math.inf
                nodes['calibrator'].stop(signal.SIGKILL)
                nodes['calibrator'] = start_calibrator(graph, saved)
        for name, process in nodes.items():
            print(f'{name}: exit status {process.stop()} {process.output[-500:]}')
    finally:
        board.terminate()
    print_calibration(monitor)
    print_stamps(monitor)
    print_latencies(monitor)
    print_usage(used)
    print_health(monitor)


if __name__ == '__main__':
    main()
