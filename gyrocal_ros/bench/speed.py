"""Time and memory of the filter alone, and of whole processes beside reading the same bag with rosbags."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.sim.scenarios import Scenario, find_scenario
from gyrocal_ros.sim.world import SimSource

LAUNCHER = """
import json, os, subprocess, sys
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
cpu_s = usage.ru_utime + usage.ru_stime
print(json.dumps([os.waitstatus_to_exitcode(status), cpu_s, usage.ru_maxrss]))
"""
"""Program that starts the measured process: a process inherits the peak memory of its parent, so the parent
has to be small."""
READER = """
import pathlib, sys
from rosbags.highlevel import AnyReader
with AnyReader([pathlib.Path(sys.argv[1])]) as reader:
    for connection, _, raw in reader.messages():
        reader.deserialize(raw, connection.msgtype)
"""
"""Program that does what no replay can do without: it reads and deserialises all messages of a bag."""
HIDDEN = ('scale_cubic=0.004', 'bias_temperature=0.0005')
"""Effects of the recording that is improved."""
MAX_DIAGNOSED_S = 300.0
"""Longest recording that is diagnosed."""
NO_BYTECODE = 'PYTHONDONTWRITEBYTECODE'
"""Environment variable of developers with which every start compiles all modules again."""
SINGLE_THREAD = {'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}


@dataclass(frozen=True, slots=True)
class Process:
    """Time and memory of a finished child process."""

    cpu_s: float
    peak_mb: float


def filter_alone(scenario: Scenario, repeats: int = 3) -> dict[str, Any]:
    """Return the best of several runs of the filter over measurements in memory.

    CPU time, here and below: it is the same on a machine that others use, too.
    """
    source = SimSource(scenario, 0)
    measurements = list(source.measurements())
    times_s = []
    for _ in range(repeats):
        slam = SlamStream(EkfSlam(default_model(), Config(), source.rig))
        started_s = time.process_time()
        for measurement in measurements:
            slam.step(measurement)
        slam.finish()
        times_s.append(time.process_time() - started_s)
    return {
        'case': f'filter alone, {scenario.imu_hz} Hz IMU, {scenario.camera_hz} images/s',
        'cpu_s': min(times_s),
        'times_real_time': scenario.duration_s / min(times_s),
        'times_reading': None,
        'times_replay': None,
        'peak_mb': None,
    }


def gyrocal_process(*words: str) -> Process:
    """Run `gyrocal` as a user does, with one thread.

    Raises:
        RuntimeError: the command failed.
    """
    return _process('-m', 'gyrocal_ros.cli.main', *words)


def reading_process(bag: Path) -> Process:
    """Read and deserialise all messages of a bag with rosbags alone, in a process of its own.

    Raises:
        RuntimeError: rosbags cannot read the bag.
    """
    return _process('-c', READER, str(bag))


def _process(*words: str) -> Process:
    command = [sys.executable, *words]
    environment = {name: value for name, value in os.environ.items() if name != NO_BYTECODE}
    launched = subprocess.run(
        [sys.executable, '-c', LAUNCHER, *command],
        stdout=subprocess.PIPE,
        env=environment | SINGLE_THREAD,
        check=True,
    )
    status, cpu_s, peak_kb = json.loads(launched.stdout)
    if status != 0:
        raise RuntimeError(f'{" ".join(command)} failed')
    return Process(cpu_s, peak_kb / 1024.0)


def whole_process(folder: Path, duration_s: float, images: bool) -> Iterator[dict[str, Any]]:
    """Write a bag, and yield the rows of its replay and, in the shorter recordings, of its diagnosis."""
    kind = 'images' if images else 'features'
    bag = folder / f'{kind}-{duration_s:.0f}'
    scenario = 'filmed' if images else 'cleaning'
    options = ['--images'] if images else []
    gyrocal_process('simulate', str(bag), '--scenario', scenario, '--duration', str(duration_s), *options)
    read = reading_process(bag)
    replayed = gyrocal_process('replay', str(bag), '--json')
    what = f'{duration_s:.0f} s of {kind}, whole process'
    yield _row(f'replay of {what}', duration_s, replayed, times_reading=replayed.cpu_s / read.cpu_s)
    if not images and duration_s <= MAX_DIAGNOSED_S:
        diagnosed = gyrocal_process('diagnose', str(bag), '--json')
        yield _row(
            f'diagnose of {what}', duration_s, diagnosed, times_replay=diagnosed.cpu_s / replayed.cpu_s
        )


def improvement(folder: Path, duration_s: float) -> dict[str, Any]:
    """Return the row of `gyrocal improve` on a recording with two hidden effects."""
    bag = folder / 'hidden'
    hidden = [word for effect in HIDDEN for word in ('--effect', effect)]
    gyrocal_process('simulate', str(bag), '--scenario', 'cleaning', '--duration', str(duration_s), *hidden)
    replayed = gyrocal_process('replay', str(bag), '--json')
    improved = gyrocal_process('improve', str(bag), '--json')
    case = f'improve of {duration_s:.0f} s of features, two effects, whole process'
    return _row(case, duration_s, improved, times_replay=improved.cpu_s / replayed.cpu_s)


def _row(case: str, duration_s: float, process: Process, **ratios: float) -> dict[str, Any]:
    return {
        'case': case,
        'cpu_s': process.cpu_s,
        'times_real_time': duration_s / process.cpu_s,
        'times_reading': ratios.get('times_reading'),
        'times_replay': ratios.get('times_replay'),
        'peak_mb': process.peak_mb,
    }


def speed(quick: bool = False) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table: filter alone, then whole processes on temporary bags.

    times_reading: processor time over that of reading and deserialising the bag with rosbags alone.
    times_replay: the same over that of `gyrocal replay`.
    """
    yield filter_alone(find_scenario('lanes'))
    if quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        for images, durations_s in ((False, (60.0, 300.0, 1200.0)), (True, (60.0, 300.0))):
            for duration_s in durations_s:
                yield from whole_process(Path(folder), duration_s, images)
        yield improvement(Path(folder), 300.0)
