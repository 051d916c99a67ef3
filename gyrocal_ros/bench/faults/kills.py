"""Kills a replay at a random moment; its folder must hold the files of one run, the old or the new one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random

from gyrocal_ros.bench.faults.isolated import run_isolated
from gyrocal_ros.files import new_folder

NAMES = tuple(f'file_{number}.json' for number in range(20))
SIZE = 20_000
"""Length of the content of each file."""
LONGEST_S = 0.05
"""Latest kill: about the time in which all files are written and exchanged."""


def write_run(folder: Path, run: int) -> int:
    """Write the files of one run, over those of an earlier one."""
    with new_folder(folder, overwrite=True) as part:
        for name in NAMES:
            (part / name).write_text(json.dumps({'run': run, 'content': 'x' * SIZE}), encoding='utf-8')
    return 0


def kill_while_writing(random: Random, folder: Path, write: Callable[[Path, int], int] = write_run) -> str:
    """Write a run, kill a second one that overwrites it, and write a third one.

    Returns:
        What is wrong with the files; empty if nothing is.
    """
    target = folder / 'result'
    write(target, 1)
    run_isolated(lambda: write(target, 2), kill_after_s=random.uniform(0.0, LONGEST_S))
    if problem := _mixed(target):
        return f'after the kill: {problem}'
    write(target, 3)
    left = sorted(item.name for item in folder.iterdir())
    return _mixed(target) or ('' if left == ['result'] else f'left behind: {left}')


def _mixed(folder: Path) -> str:
    try:
        runs = {json.loads((folder / name).read_text(encoding='utf-8'))['run'] for name in NAMES}
    except (OSError, ValueError) as error:
        return f'{type(error).__name__}: {error}'
    return '' if len(runs) == 1 else f'files of the runs {sorted(runs)}'
