"""Turns of a gyro compared with those of a heading reference that is rare, late, inverted or another one."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.bag.topic_stats import TurnComparison, TurnStats, compare_turns
from gyrocal_ros.data import Array, IntArray

DURATION_S = 120.0


def rates(time_s: Array, seed: int = 0) -> Array:
    """Return the yaw rate (n,) of a car: turns of some 2 s to either side, of irregular lengths."""
    rng = np.random.default_rng(seed)
    ends_s = np.cumsum(rng.uniform(0.8, 3.0, 150))
    levels = rng.choice([-1.2, -0.5, 0.0, 0.7, 1.3], 151)
    return np.asarray(levels[np.searchsorted(ends_s, time_s)])


def stamps_ns(hz: float, late_s: float = 0.0) -> IntArray:
    return np.rint(1e9 * (np.arange(0.0, DURATION_S, 1.0 / hz) + late_s)).astype(np.int64)


def gyro(hz: float = 50.0) -> TurnStats:
    turns, stamps = TurnStats(), stamps_ns(hz)
    turns.add(stamps, rates(stamps / 1e9) + 0.005)
    return turns


def reference(hz: float, late_s: float = 0.0, sign: float = 1.0, seed: int = 0) -> TurnStats:
    fine_s = np.arange(0.0, DURATION_S, 0.001)
    yaw = np.cumsum(0.001 * rates(fine_s, seed))
    stamps = stamps_ns(hz, late_s)
    turns = TurnStats()
    turns.add_headings(stamps, sign * np.interp(stamps / 1e9 - late_s, fine_s, yaw))
    return turns


def compared(other: TurnStats) -> TurnComparison:
    found = compare_turns(gyro(), other)
    assert found is not None
    return found


@pytest.mark.parametrize('hz', [1.0, 1.7, 3.0, 20.0])
@pytest.mark.parametrize('late_s', [-0.3, 0.0, 0.6])
def test_a_rare_or_late_reference_agrees(hz: float, late_s: float) -> None:
    found = compared(reference(hz, late_s))
    assert found.correlation > 0.9
    assert found.ratio == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize('late_s', [0.0, 0.6])
def test_an_inverted_one_is_told_from_a_late_one(late_s: float) -> None:
    assert compared(reference(20.0, late_s, sign=-1.0)).correlation < -0.9


@pytest.mark.parametrize('seed', range(1, 6))
def test_that_of_another_drive_does_not_agree(seed: int) -> None:
    assert abs(compared(reference(20.0, seed=seed)).correlation) < 0.6
    assert abs(compared(reference(1.0, seed=seed)).correlation) < 0.6
