"""The engine of fleets: bags per minute, overhead, memory of the workers, and kills at random moments."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal_ros.bag.write import new_bag
from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model
from gyrocal_ros.fleet.engine import cluster, run_fleet
from gyrocal_ros.fleet.plan import plan_bags
from gyrocal_ros.fleet.result import BagResult
from gyrocal_ros.fleet.store import CALIBRATIONS, SCORES, FleetStore
from gyrocal_ros.fleet.table import read_fleet
from gyrocal_ros.fleet.work import job_of
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

SCENARIO, DURATION_S = 'demo', 20.0
MADE = 10
"""Number of different bags; a larger fleet has copies of them."""
DAMAGED_PART = 0.05
DAMAGED_AT = 0.5
"""Part of its length that is left of a damaged bag."""
KILLS = 10
LONGEST_S = 25.0
"""Latest moment of a kill after the start of the command."""


def engine(bags: int) -> Iterator[dict[str, Any]]:
    """Yield speed, overhead and memory with one and with two workers, then what kills leave.

    Args:
        bags: number of bags of the fleet.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _make_bags(folder / 'bags', bags)
        per_minute = []
        for workers in (1, 2):
            row = _speed(folder / 'bags', folder / f'by_{workers}', workers)
            per_minute.append(row['bags_per_minute'])
            yield row | {'times_one_worker': per_minute[-1] / per_minute[0]}
        yield _kills(folder / 'bags', folder / 'killed', folder / 'by_1')


def _make_bags(folder: Path, count: int) -> None:
    """Write bags, some of them damaged; most are copies of a few simulated ones."""
    scenario = replace(find_scenario(SCENARIO), duration_s=DURATION_S)
    made = []
    for seed in range(min(MADE, count)):
        source, path = SimSource(scenario, seed), folder / 'made' / str(seed)
        with new_bag(path, 'mcap') as bag:
            bag.write_rig(source.rig, source.span.start_ns, R_bi=np.eye(3))
            for measurement in source.measurements():
                bag.write(measurement)
        made.append(next(path.glob('*.mcap')))
    (folder / 'fleet').mkdir()
    for number in range(count):
        content = made[number % len(made)].read_bytes()
        is_damaged = number < DAMAGED_PART * count
        path = folder / 'fleet' / f'robot_{number // 4:03d}' / f'{number:04d}.mcap'
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content[: int(DAMAGED_AT * len(content))] if is_damaged else content)


def _speed(bags: Path, out: Path, workers: int) -> dict[str, Any]:
    planned = plan_bags([str(bags / 'fleet')])
    with cluster(workers=workers) as client:
        sizes: list[float] = []

        def report(result: BagResult) -> None:
            if len(sizes) < len(planned):
                sizes.append(max(client.run(_resident_mb).values()))

        done = run_fleet(planned, job_of(Config(), default_model()), FleetStore(out), client, report)
    half = len(sizes) // 2
    return {
        'figure': f'{workers} worker{"s" if workers > 1 else ""}',
        'bags': done.bags,
        'calibrated': done.calibrated,
        'bags_per_minute': 60.0 * done.bags / done.wall_s,
        'overhead': 1.0 - done.work_s / (workers * done.wall_s),
        'worker_mb_first_half': max(sizes[:half]),
        'worker_mb_second_half': max(sizes[half:]),
    }


def _kills(bags: Path, out: Path, reference: Path) -> dict[str, Any]:
    """Kill the command or a worker at random moments, continue, and compare with an undisturbed run."""
    rng = np.random.default_rng(0)
    command = [sys.executable, '-m', 'gyrocal_ros.cli.main', 'fleet', 'run', str(bags / 'fleet')]
    command += ['-o', str(out), '--workers', '2']
    killed = {'command': 0, 'worker': 0}
    for number in range(KILLS):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(rng.uniform(0.0, LONGEST_S))
            workers = _workers(process.pid)
            if number % 2 and workers and process.poll() is None:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                killed['worker'] += 1
                time.sleep(rng.uniform(0.0, LONGEST_S))
            if process.poll() is None:
                process.kill()
                killed['command'] += 1
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    names = read_fleet([out]).columns['bag']
    same = all(
        (out / file).read_bytes() == (reference / file).read_bytes() for file in (CALIBRATIONS, SCORES)
    )
    left = [file for file in out.rglob('*') if file.name.endswith('.part')]
    return {
        'figure': 'kills at random moments',
        'bags': len(names),
        'bags_once': len(set(names)),
        'killed_commands': killed['command'],
        'killed_workers': killed['worker'],
        'same_bytes': same,
        'half_written_files': len(left),
    }


def _workers(pid: int) -> list[int]:
    """Return the process ids of the workers of a command."""
    try:
        tasks = Path(f'/proc/{pid}/task').iterdir()
        children = {int(child) for task in tasks for child in (task / 'children').read_text().split()}
        return sorted(
            child for child in children if 'spawn_main' in Path(f'/proc/{child}/cmdline').read_text()
        )
    except OSError:
        return []


def _resident_mb() -> float:
    """Return the resident memory of this process."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6
