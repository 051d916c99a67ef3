"""The bench of fleets, with the filter's results replaced by drawn ones."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.bench import fleet as bench
from gyrocal_ros.fleet.result import BagScores

STD = 7e-5


def measured(count: int = 40, candidates: int = 8) -> tuple[bench.Measured, ...]:
    """Draw results as the filter would give them for clean recordings."""
    rng = np.random.default_rng(0)
    items = []
    for _ in range(count):
        root = rng.standard_normal((candidates, 3 * candidates))
        information = root @ root.T
        scores = BagScores(
            names=tuple(f'effect_{number}.k' for number in range(candidates)),
            units=('1',) * candidates,
            information=information,
            score=root @ rng.standard_normal(3 * candidates),
            std=np.diagonal(information) ** -0.5,
        )
        error = STD * rng.standard_normal()
        temperature = 25.0 + rng.standard_normal()
        items.append(bench.Measured(error, STD, 0.0, 1e-4, True, temperature, scores, 10.0))
    return tuple(items)


@pytest.fixture(autouse=True)
def _drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    values = measured()
    monkeypatch.setattr(bench, '_measured', lambda: values)


def test_the_truth_of_drawn_fleets_is_in_the_intervals_and_faults_are_found() -> None:
    row = bench.coverage(6)
    assert min(row['mean_inside'], row['spread_inside'], row['ageing_inside']) >= 4 / 6
    assert row['faulty_found'] == '12 of 12'
    assert row['falsely_called'] <= 1


def test_effects_of_drawn_fleets_are_named_and_clean_ones_stay_clean() -> None:
    hidden, clean = bench.effects(5)
    assert hidden['named_first'] == hidden['found'] == 5
    assert hidden['sigma_median'] > 5.0
    assert (clean['fleets'], clean['found']) == (10, 0)


def test_a_large_fleet_is_measured() -> None:
    row = bench.large(400)
    assert row['wall_s'] > 0.0 and row['bytes_per_bag'] > 100.0
