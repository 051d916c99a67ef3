"""The bench of fleets, with the filter's results replaced by drawn ones."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.bench import fleet as bench
from gyrocal_ros.bench import fleet_prior
from gyrocal_ros.effects import SCALE_FACTOR
from gyrocal_ros.ekf.state.start import Start
from gyrocal_ros.fleet.result import CALIBRATED, BagScores
from gyrocal_ros.sim.fleet import FleetBag

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
        items.append(bench.Measured(error, STD, 0.0, 1e-4, True, temperature, scores))
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


def test_the_prior_of_the_other_robots_is_consistent_with_each(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, starts = np.random.default_rng(0), []

    def calibrated(effect: str | None, task: tuple[FleetBag, Start | None]) -> fleet_prior._Calibrated:
        bag, start = task
        starts.append(start)
        error = STD * rng.standard_normal()
        row = {'status': CALIBRATED, 'reason': '', 'converged': True, 'temperature_c': 25.0}
        row |= {'bias': 1e-4 * rng.standard_normal(), 'bias_std': 1e-4, 'duration_s': 60.0}
        row |= {SCALE_FACTOR: bag.scale_factor + error, f'{SCALE_FACTOR}_std': STD}
        return fleet_prior._Calibrated(row, error / STD, 30.0 if start is None else 10.0)

    monkeypatch.setattr(fleet_prior, '_calibrated', calibrated)
    monkeypatch.setattr(fleet_prior, 'in_parallel', map)
    monkeypatch.setattr(fleet_prior, '_can_be_common', lambda name: False)
    (row,) = fleet_prior.priors()
    assert starts.count(None) == len(starts) / 2 == fleet_prior.ROBOTS
    assert 0.7 < row['prior_z_rms'] < 1.3, 'the spread of the other robots holds for this one'
    assert (row['to_0.1_percent_s'], row['with_prior_s']) == (30.0, 10.0)
