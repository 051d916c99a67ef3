"""Accuracy and consistency over many seeds, compared with the paper's parametrisation and the bound."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any, TypeVar

import numpy as np

from gyrocal_ros.bench.bench_run import BenchRun, Variant, run_bench
from gyrocal_ros.sim.scenarios import Scenario, find_scenario

T = TypeVar('T')
R = TypeVar('R')

OURS = Variant('inverse_depth')
PAPER = Variant('paper form, eq. (8) bias', 'camera_frame', motion_gate=False, settling_bias=True)
PAPER_GATED = Variant('paper form, motion gate', 'camera_frame')
CONVENTIONAL = Variant('conventional pixel', 'pixel')


def in_parallel(function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
    """Map a function over tasks on all cores, in order, with one thread of linear algebra per process.

    The processes are spawned, because a forked one would inherit the threads of its parent.
    """
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
        yield from pool.map(function, tasks)


def first_seeds(labels: Sequence[T], seeds: int) -> dict[T, int]:
    """Return the first seed of each case, of some seeds in a row.

    No two recordings share a seed: what one robot shows by chance would count in every case.
    """
    return {label: seeds * place for place, label in enumerate(labels)}


Case = tuple[str, Scenario, Variant, bool, bool]
"""Label, scenario, variant, True for images in place of features, True for the bound."""


def cases(quick: bool) -> list[Case]:
    """Return the cases of the benchmark; `quick` selects the first one."""
    lanes, cleaning = find_scenario('lanes'), find_scenario('cleaning')
    table: list[Case] = [
        ('lanes', lanes, OURS, False, True),
        ('cleaning', cleaning, OURS, False, True),
        ('lanes', lanes, PAPER, False, False),
        ('lanes', lanes, PAPER_GATED, False, False),
        ('lanes', lanes, CONVENTIONAL, False, False),
        ('lanes, 5 features', replace(lanes, features=5), OURS, False, False),
        ('lanes, 180 s standing', replace(lanes, standing_s=180.0, duration_s=480.0), OURS, False, False),
        ('cleaning, 2 % outliers', _with_outliers(cleaning), OURS, False, False),
        ('images, 120 s', replace(cleaning, duration_s=120.0, camera_hz=10), OURS, True, False),
    ]
    return table[:1] if quick else table


def accuracy_row(case: Case, runs: list[BenchRun]) -> dict[str, Any]:
    """Return the figures of one case over its seeds; errors in per cent of the scale factor."""
    label, _, variant, _, _ = case
    good = [run for run in runs if not run.diverged]

    def column(name: str) -> np.ndarray:
        return np.array([getattr(run, name) for run in good])

    final = 100.0 * column('final_error')
    bound = column('bound_std')
    return {
        'case': label,
        'variant': variant.name,
        'seeds': len(runs),
        'diverged': len(runs) - len(good),
        'early_max_percent': _max(100.0 * column('early_error')),
        'settled_max_percent': _max(100.0 * column('settled_error')),
        'final_rms_percent': _rms(final),
        'final_max_percent': _max(final),
        'std_percent': _rms(100.0 * column('final_std')),
        'nees': float(np.mean(column('nees'))) if good else None,
        'inside_3_sigma': float(np.mean(column('nees') < 9.0)) if good else None,
        'nis_per_dof_min': float(column('nis_per_dof').min()) if good else None,
        'nis_per_dof_max': float(column('nis_per_dof').max()) if good else None,
        'std_by_bound_max': _max(column('final_std') / bound) if np.isfinite(bound).any() else None,
        'heading_rms_deg': _rms(np.degrees(column('heading_rms_rad'))),
    }


def accuracy(seeds: int, quick: bool = False, only: Collection[str] = ()) -> Iterator[dict[str, Any]]:
    """Yield the rows of the accuracy table as they become ready, for all cases or those with some labels."""
    for case in (case for case in cases(quick) if not only or case[0] in only):
        yield accuracy_row(case, list(in_parallel(_run, [(case, seed) for seed in range(seeds)])))


def _run(task: tuple[Case, int]) -> BenchRun:
    (_, scenario, variant, images, with_bound), seed = task
    return run_bench(scenario, seed, variant, images=images, with_bound=with_bound)


def _with_outliers(scenario: Scenario) -> Scenario:
    return replace(scenario, errors=replace(scenario.errors, outliers=0.02))


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _max(values: np.ndarray) -> float | None:
    return float(np.abs(values).max()) if len(values) else None
