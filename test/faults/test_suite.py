"""A small part of the fault suite, and tests of its verdicts. All of it: `gyrocal bench faults`."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

from gyrocal_ros.bench.faults.isolated import Outcome
from gyrocal_ros.bench.faults.kills import NAMES, kill_while_writing
from gyrocal_ros.bench.faults.references import REFERENCE_FAULTS
from gyrocal_ros.bench.faults.semantic import FAULTS, sized
from gyrocal_ros.bench.faults.suite import BAD, KINDS, Verdict, cases, judged
from gyrocal_ros.errors import GyrocalError

MEGABYTE = 10**6


def replayed(scale_factor: float, std: float, converged: bool = True) -> Outcome:
    result = {'scale_factor': scale_factor, 'scale_factor_std': std, 'converged': converged}
    return Outcome(0, json.dumps(result), '', 100 * MEGABYTE)


@pytest.mark.parametrize(
    ('outcome', 'true', 'verdict'),
    [
        (replayed(1.0, 1e-4), 1.0, Verdict.RIGHT),
        (replayed(1.0009, 1e-4), 1.0, Verdict.RIGHT),
        (replayed(1.002, 1e-3), 1.0, Verdict.RIGHT),
        (replayed(1.002, 1e-4), 1.0, Verdict.WRONG),
        (replayed(1.002, 1e-4, converged=False), 1.0, Verdict.NOT_CONVERGED),
        (replayed(1.0, 1e-4), math.nan, Verdict.WRONG),
        (Outcome(2, '', 'gyrocal: error: no u; add u', MEGABYTE), 1.0, Verdict.REJECTED),
        (Outcome(2, '', 'gyrocal: error: no u\nsecond line', MEGABYTE), 1.0, Verdict.TRACEBACK),
        (Outcome(1, '', 'Traceback (most recent call last):', MEGABYTE), 1.0, Verdict.TRACEBACK),
        (Outcome(-11, '', '', MEGABYTE), 1.0, Verdict.TRACEBACK),
        (Outcome(-24, '', '', MEGABYTE), 1.0, Verdict.TIMEOUT),
        (Outcome(0, '', '', 1600 * MEGABYTE), 1.0, Verdict.TIMEOUT),
        (Outcome(0, 'text', '', MEGABYTE), 1.0, Verdict.SURVIVED),
    ],
)
def test_verdicts(outcome: Outcome, true: float, verdict: Verdict) -> None:
    assert judged(outcome, true)[0] is verdict


def test_the_whole_suite_is_as_large_as_documented() -> None:
    assert len(list(sized(FAULTS))) >= 80
    assert len(list(cases(20))) >= 3000
    assert {case.kind for case in cases(1)} == {*KINDS, 'semantic', 'references', 'sound'}
    assert all(fault.sizes for fault in FAULTS.values())
    assert all(fault.sizes for fault in REFERENCE_FAULTS.values())
    with pytest.raises(GyrocalError, match='not a kind of fault'):
        list(cases(1, ['cloud']))


def test_a_kill_while_files_are_written_in_place_is_found(tmp_path: Path) -> None:
    """The case fails for a writer that is not atomic."""

    def write_in_place(folder: Path, run: int) -> int:
        folder.mkdir(exist_ok=True)
        for name in NAMES[: len(NAMES) // (2 if run == 2 else 1)]:
            (folder / name).write_text(json.dumps({'run': run}), encoding='utf-8')
        return 0

    script = 'the runs [1, 2]'
    write_in_place(tmp_path / 'result', 1)
    assert script in kill_while_writing(Late(1), tmp_path, write_in_place)


class Late(Random):
    """Random numbers at the end of their range, so that the kill comes after the work."""

    def uniform(self, a: float, b: float) -> float:
        return 20.0


@pytest.mark.slow
def test_two_cases_of_each_kind_of_damage() -> None:
    """In a process of its own, because it forks."""
    command = [sys.executable, '-m', 'gyrocal_ros.cli.main', 'bench', 'faults', '--quick', '--json']
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)['benches']['faults']
    assert [row['kind'] for row in rows] == list(KINDS)
    for row in rows:
        assert row['tried'] == 2
        assert not any(row[verdict] for verdict in BAD), done.stderr
