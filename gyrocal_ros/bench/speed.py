"""Time and memory of the filter alone, and of whole `gyrocal replay` processes."""

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
        'peak_mb': None,
    }


def gyrocal_process(*words: str) -> Process:
    """Run `gyrocal` as a user does, with one thread.

    Raises:
        RuntimeError: the command failed.
    """
    command = [sys.executable, '-m', 'gyrocal_ros.cli.main', *words]
    launched = subprocess.run(
        [sys.executable, '-c', LAUNCHER, *command],
        stdout=subprocess.PIPE,
        env=os.environ | SINGLE_THREAD,
        check=True,
    )
    status, cpu_s, peak_kb = json.loads(launched.stdout)
    if status != 0:
        raise RuntimeError(f'{" ".join(command)} failed')
    return Process(cpu_s, peak_kb / 1024.0)


def whole_process(folder: Path, duration_s: float, images: bool) -> dict[str, Any]:
    """Write a bag, replay it and return the row of the table."""
    kind = 'images' if images else 'features'
    bag = folder / f'{kind}-{duration_s:.0f}'
    scenario = 'filmed' if images else 'cleaning'
    options = ['--images'] if images else []
    gyrocal_process('simulate', str(bag), '--scenario', scenario, '--duration', str(duration_s), *options)
    process = gyrocal_process('replay', str(bag), '--json')
    return {
        'case': f'replay of {duration_s:.0f} s of {kind}, whole process',
        'cpu_s': process.cpu_s,
        'times_real_time': duration_s / process.cpu_s,
        'peak_mb': process.peak_mb,
    }


def speed(quick: bool = False) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table: filter alone, then whole processes on temporary bags."""
    yield filter_alone(find_scenario('lanes'))
    if quick:
        return
    with tempfile.TemporaryDirectory() as folder:
        for images, durations_s in ((False, (60.0, 300.0, 1200.0)), (True, (60.0, 300.0))):
            for duration_s in durations_s:
                yield whole_process(Path(folder), duration_s, images)
