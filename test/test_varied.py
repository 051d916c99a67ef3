"""Scenarios drawn at random: the same for a seed, different from seed to seed, and all can be simulated."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gyrocal_ros.bench import blind as bench
from gyrocal_ros.bench.blind import run_blind
from gyrocal_ros.bench.blind_cases import Case
from gyrocal_ros.data import ImuSample
from gyrocal_ros.sim.varied import CAMERA_HZ, DURATION_S, IMU_HZ, varied_scenario
from gyrocal_ros.sim.world import SimSource


def test_a_seed_draws_one_scenario_and_another_seed_another() -> None:
    drawn = [varied_scenario(seed) for seed in range(30)]
    assert drawn == [varied_scenario(seed) for seed in range(30)]
    assert len({scenario.duration_s for scenario in drawn}) == 30
    assert {scenario.imu_hz for scenario in drawn} == set(IMU_HZ)
    assert {scenario.camera_hz for scenario in drawn} == set(CAMERA_HZ)
    assert all(DURATION_S[0] <= scenario.duration_s <= DURATION_S[1] for scenario in drawn)
    assert len({scenario.stages[0][0] for scenario in drawn}) > 2


@pytest.mark.parametrize('seed', range(4))
def test_every_one_can_be_simulated(seed: int) -> None:
    scenario = replace(varied_scenario(seed), duration_s=12.0)
    readings = [item for item in SimSource(scenario, seed).measurements() if isinstance(item, ImuSample)]
    assert len(readings) == pytest.approx(12.0 * scenario.imu_hz, rel=0.02)


def test_a_varied_trial_takes_the_scenario_of_its_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def drawn(seed: int) -> None:
        asked.append(seed)
        raise LookupError('the rest of a trial takes minutes')

    monkeypatch.setattr(bench, 'varied_scenario', drawn)
    with pytest.raises(LookupError):
        run_blind(Case('none'), 7, varied=True)
    assert asked == [7]
