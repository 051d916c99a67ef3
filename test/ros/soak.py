"""Runs the nodes on an emulated robot for hours, with a random fault every minute, and prints what they used.

    python test/ros/soak.py --minutes 120 --seed 1

Board and camera are emulated, as in emulated_trial.py. Faults come from a list that is shuffled by the seed;
those that restart a node come in the first third only, so that the memory, threads and open files of the same
processes are compared over the rest. Every saved calibration is compared with the truth. Ctrl-C ends the
drive early. Exit status 1: a calibration is converged and wrong, a node ended by itself, did not end on
SIGINT, or printed a traceback. Needs a sourced ROS; not a test, because it runs in real time.
"""

from __future__ import annotations

import argparse
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import TypeAlias

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from emulated_trial import (
    FAKETIME,
    READY_S,
    SCENARIO,
    start_board,
    start_calibrator,
    start_camera,
    start_driver,
    usage,
)
from graph import Graph, NodeProcess

from gyrocal_ros.errors import GyrocalError
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.pipeline.calibration import load_calibration
from gyrocal_ros.sim.scenarios import find_scenario

SAMPLE_S, FAULT_S, SETTLE_S = 30.0, 60.0, 600.0
"""Interval of the samples, interval of the faults, and the time that a process has to settle."""
FREE_S = 90.0
"""Time at the start, and half of that at the end, without faults."""
RESTARTS_UNTIL = 1.0 / 3.0
"""Part of the drive in which nodes are killed."""
GAIN_KNOWN_S = 120.0
"""Time after a wrong gain during which either gain may be the one that is found: two turns each way."""
MAX_SIGMA = 3.0
NODES = ('driver', 'tracker', 'calibrator')
BOARD_FAULTS = {
    **{'unplug': (0.0,), 'pause': (0.0,), 'restart': (0.0,)},
    **{'noise': (0.01, 0.05, 0.3), 'cut': (0.1, 0.5), 'drop': (0.05, 0.5), 'gain': (0.002, 0.02, 0.1)},
}
"""Faults of the board emulator and their sizes; 0 for none."""
CAMERA_FAULTS = ('cover', 'off', 'freeze', 'lose')
RELIABILITY = f'qos_overrides./{Role.IMAGE}.publisher.reliability'


@dataclass(frozen=True)
class Fault:
    """A fault of the robot and its interval."""

    kind: str
    from_s: float
    to_s: float
    size: float
    node: str
    """Node that is affected, for the faults that affect one."""

    def __str__(self) -> str:
        size = f' {self.size:g}' if self.size else ''
        node = f' {self.node}' if self.kind in ('kill', 'stop') else ''
        return f'{self.kind}{size}{node} for {self.to_s - self.from_s:.0f} s'


class Robot:
    """The emulated robot: its nodes, its files, and its faults."""

    def __init__(self, graph: Graph, folder: Path, args: argparse.Namespace, faults: list[Fault]) -> None:
        self.graph = graph
        self.duration_s, self.seed = 60.0 * args.minutes, args.seed
        self.port, self.clock = folder / 'board', folder / 'clock'
        self.saved = folder / 'kept' / 'calibration.yaml'
        self.saved.parent.mkdir()
        self.start_s = time.time() + READY_S
        self.troubles = ' '.join(
            f'{fault.kind}@{fault.from_s:.1f}+{fault.to_s - fault.from_s:.1f}'
            for fault in faults
            if fault.kind in (*CAMERA_FAULTS, 'clock')
        )
        self.board = start_board(self.port, self.start_s, self.duration_s, self.seed, stdin=subprocess.PIPE)
        self.is_reliable = True
        self.camera = self._camera()
        self.nodes = {name: self._node(name) for name in NODES}

    def time_s(self) -> float:
        """Return the time since the start of the drive."""
        return time.time() - self.start_s

    def restart(self, name: str) -> None:
        """Kill a node and start it again."""
        self.nodes[name].stop(signal.SIGKILL)
        self.nodes[name] = self._node(name)

    def restart_camera(self) -> None:
        """Start the camera again, with the other reliability."""
        self.camera.stop()
        self.is_reliable = not self.is_reliable
        self.camera = self._camera()

    def _camera(self) -> NodeProcess:
        qos = {RELIABILITY: 'reliable' if self.is_reliable else 'best_effort'}
        return start_camera(self.graph, self.start_s, self.duration_s, self.seed, self.troubles, **qos)

    def _node(self, name: str) -> NodeProcess:
        if name == 'driver':
            return start_driver(self.graph, self.port, self.clock if FAKETIME else None)
        return start_calibrator(self.graph, self.saved) if name == 'calibrator' else self.graph.start(name)


End: TypeAlias = Callable[[], object]
"""Function that ends a fault; `int` does nothing, for those that end by themselves."""


def damage_board(robot: Robot, fault: Fault) -> End:
    assert robot.board.stdin is not None
    size = f'={fault.size}' if fault.size else ''
    robot.board.stdin.write(f'{fault.kind}+{fault.to_s - fault.from_s:.1f}{size}\n')
    robot.board.stdin.flush()
    return int


def step_clock(robot: Robot, fault: Fault) -> End:
    robot.clock.write_text('+2')  # the camera has the same step, by its settings
    return lambda: robot.clock.write_text('+0')


def stop_node(robot: Robot, fault: Fault) -> End:
    process = robot.nodes[fault.node]
    process.send(signal.SIGSTOP)
    return lambda: process.send(signal.SIGCONT)


def kill_node(robot: Robot, fault: Fault) -> End:
    robot.restart(fault.node)
    return int


def change_qos(robot: Robot, fault: Fault) -> End:
    robot.restart_camera()
    return int


def fill_disk(robot: Robot, fault: Fault) -> End:
    """Let every write of a file fail, as on a full disk, also for the user root."""
    pid = robot.nodes['calibrator'].pid
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, before[1]))
    return lambda: resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def block_folder(robot: Robot, fault: Fault) -> End:
    """Put a file in the place of the folder, where nothing can be saved, not even by the user root."""
    folder = robot.saved.parent
    away = folder.rename(folder.with_name('away'))
    folder.touch()

    def end() -> None:
        folder.unlink()
        away.rename(folder)

    return end


def damage_file(robot: Robot, fault: Fault) -> End:
    text = robot.saved.read_bytes() if robot.saved.exists() else b'?'
    robot.saved.write_bytes(text[: int(len(text) * fault.size)] + b'\xff\x00: [')
    robot.restart('calibrator')
    return int


KINDS: dict[str, Callable[[Robot, Fault], End]] = {
    **dict.fromkeys(BOARD_FAULTS, damage_board),
    **dict.fromkeys(CAMERA_FAULTS, lambda robot, fault: int),  # by the settings of the camera
    'stop': stop_node,
    'camera qos': change_qos,
    'disk full': fill_disk,
    'folder blocked': block_folder,
    'kill': kill_node,
    'file damaged': damage_file,
}
if FAKETIME is not None:
    KINDS['clock'] = step_clock
RESTARTING = ('kill', 'file damaged')


def plan(seed: int, duration_s: float) -> list[Fault]:
    """Draw the faults: every kind once, then every kind again, in an order that the seed shuffles."""
    random, left, faults = Random(seed), list[str](), list[Fault]()
    for number in range(int((duration_s - 1.5 * FREE_S) // FAULT_S) + 1):
        at_s = FREE_S + number * FAULT_S
        may_restart = at_s < RESTARTS_UNTIL * duration_s
        kinds = [kind for kind in KINDS if may_restart or kind not in RESTARTING]
        left = [kind for kind in left if kind in kinds] or random.sample(kinds, len(kinds))
        kind = left.pop()
        sizes = BOARD_FAULTS.get(kind, (0.5,) if kind == 'file damaged' else (0.0,))
        length_s = random.choice((3.0, 8.0, 20.0, 35.0))
        begin_s = at_s + random.uniform(0.0, 10.0)
        faults.append(Fault(kind, begin_s, begin_s + length_s, random.choice(sizes), random.choice(NODES)))
    return faults


class Saved:
    """The saved calibrations, each compared with the truth."""

    def __init__(self, robot: Robot, faults: list[Fault]) -> None:
        self._robot, self._gains = robot, [fault for fault in faults if fault.kind == 'gain']
        self._version = 0
        self.sigma: list[tuple[float, float, bool]] = []
        """Time, error in standard deviations, and whether it has converged."""
        self.unreadable: list[float] = []

    def look(self) -> None:
        """Read the file if it has changed."""
        with suppress(OSError):
            version = self._robot.saved.stat().st_mtime_ns
            if version == self._version:
                return
            self._version, at_s = version, self._robot.time_s()
            try:
                found = load_calibration(self._robot.saved)
            except GyrocalError:
                self.unreadable.append(at_s)
                return
            scale, std = found.scale_factor, found.scale_factor_std
            sigma = min((scale - true for true in self._true(at_s)), key=abs) / std
            self.sigma.append((at_s, sigma, found.converged))
            print(
                f'{at_s:7.1f} s saved {scale:.6f} +- {std:.6f}, {sigma:+.2f} sigma, '
                f'converged: {found.converged}',
                flush=True,
            )

    def _true(self, at_s: float) -> list[float]:
        """Return the true scale factor; with a wrong gain, and for a time after it, either one."""
        true = find_scenario(SCENARIO).errors.scale_factor
        gains = (gain for gain in self._gains if gain.from_s <= at_s < gain.to_s + GAIN_KNOWN_S)
        return [true, *(true / (1.0 - gain.size) for gain in gains)]

    def beyond(self) -> list[tuple[float, float, bool]]:
        """Return those that are converged and wrong."""
        return [row for row in self.sigma if row[2] and abs(row[1]) > MAX_SIGMA]


@dataclass(frozen=True)
class Sample:
    """What a process uses."""

    at_s: float
    pid: int
    memory_mb: float
    threads: int
    files: int


def sample(pid: int, at_s: float) -> Sample:
    process = Path(f'/proc/{pid}')
    threads, files = len(list((process / 'task').iterdir())), len(list((process / 'fd').iterdir()))
    return Sample(at_s, pid, usage(pid, at_s).memory_mb, threads, files)


def print_used(name: str, rows: list[Sample]) -> None:
    """Print the slopes of the last process of a node, from ten minutes after its start."""
    last = [row for row in rows if row.pid == rows[-1].pid]
    settled = [row for row in last if row.at_s - last[0].at_s >= SETTLE_S]
    text = f'{name:<11}started {len({row.pid for row in rows})} times'
    if len(settled) < 3:
        print(text)
        return
    hours = np.array([row.at_s for row in settled]) / 3600.0
    for unit in ('memory_mb', 'threads', 'files'):
        values = np.array([getattr(row, unit) for row in settled], float)
        slope = np.polyfit(hours, values, 1)[0]
        text += (
            f'; {unit} {values[0]:.1f} to {values[-1]:.1f}, {values.max():.1f} at most, {slope:+.2f} per hour'
        )
    print(f'{text}, over {hours[-1] - hours[0]:.2f} h')


def follow_health(robot: Robot) -> None:
    """Print the problems that the nodes report, when they change."""
    last = dict[str, str]()

    def receive(message: DiagnosticArray) -> None:
        for status in message.status:
            text = 'OK' if status.level == b'\0' else status.message
            if (kind := re.sub(r'[\d.]+', '#', text)) != last.get(status.name):
                print(f'{robot.time_s():7.1f} s {status.name}: {text}', flush=True)
            last[status.name] = kind

    robot.graph.node.create_subscription(DiagnosticArray, '/diagnostics', receive, 100)


def drive(robot: Robot, faults: list[Fault], saved: Saved) -> tuple[dict[str, list[Sample]], list[str]]:
    """Drive to the end, or until SIGINT or SIGTERM.

    Returns:
        Samples by node, and the nodes that ended by themselves.
    """
    stopped = list[int]()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: stopped.append(number))
    used, ended = defaultdict[str, list[Sample]](list), list[str]()
    due: list[tuple[float, End]] = []
    left, next_s = list(faults), 0.0
    while (at_s := robot.time_s()) < robot.duration_s + 2.0 and not stopped:
        robot.graph.spin(0.2)
        for end_s, end in [item for item in due if item[0] <= at_s]:
            end()
            due.remove((end_s, end))
        if left and left[0].from_s <= at_s:
            fault = left.pop(0)
            print(f'{at_s:7.1f} s FAULT {fault}', flush=True)
            due.append((fault.to_s, KINDS[fault.kind](robot, fault)))
        saved.look()
        for name, process in robot.nodes.items():
            if process.status is not None:
                print(f'{at_s:7.1f} s {name} ENDED: {process.output[-2000:]}', flush=True)
                ended.append(name)
                robot.restart(name)
        if at_s >= next_s:
            next_s += SAMPLE_S
            for name, process in robot.nodes.items():
                used[name].append(sample(process.pid, at_s))
    for _, end in due:
        end()
    return used, ended


def run(robot: Robot, faults: list[Fault]) -> int:
    """Drive, print the figures, and return the exit status."""
    saved = Saved(robot, faults)
    follow_health(robot)
    used, ended = drive(robot, faults, saved)
    driven_s, failures = robot.time_s(), [f'{name} ended by itself' for name in ended]
    for name, process in robot.nodes.items():
        status = process.stop(signal.SIGINT)
        print(f'{name}: exit status {status} after SIGINT')
        failures += [f'{name}: exit status {status}'] * (status != 0)
    for process in robot.graph.processes:
        print(f'{process.name} (pid {process.pid}) printed {len(process.output.splitlines())} lines')
        if 'Traceback' in process.output:
            failures.append(f'{process.name}: traceback')
            print(process.output[-5000:])
    kinds = Counter(fault.kind for fault in faults if fault.from_s <= driven_s)
    print(f'{driven_s / 3600.0:.2f} h, {sum(kinds.values())} faults: {dict(sorted(kinds.items()))}')
    for name, rows in used.items():
        print_used(name, rows)
    converged = np.array([abs(sigma) for _, sigma, converged in saved.sigma if converged])
    print(
        f'{len(saved.sigma)} calibrations saved, {len(converged)} converged, {len(saved.beyond())} of them '
        f'beyond {MAX_SIGMA:g} sigma, worst {converged.max(initial=0.0):.2f} sigma, root mean square '
        f'{np.sqrt(np.mean(converged**2)) if len(converged) else 0.0:.2f}; '
        f'{len(saved.unreadable)} unreadable at {saved.unreadable}'
    )
    failures += [f'{sigma:+.1f} sigma at {at_s:.0f} s' for at_s, sigma, _ in saved.beyond()]
    print('FAILURES:', failures or 'none')
    return 1 if failures else 0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--minutes', type=float, default=120.0)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    faults = plan(args.seed, 60.0 * args.minutes)
    with tempfile.TemporaryDirectory() as folder, Graph() as graph:
        robot = Robot(graph, Path(folder), args, faults)
        try:
            return run(robot, faults)
        finally:
            robot.board.terminate()


if __name__ == '__main__':
    sys.exit(main())
