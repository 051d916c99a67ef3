"""Turns of a gyro compared with those of a heading reference that is rare, late, inverted or another one."""

from __future__ import annotations

import numpy as np
import pytest

from gyrocal_ros.bag.topic_stats import TurnComparison, TurnStats, compare_turns, turn_delay
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


@pytest.mark.parametrize('late_s', [-0.2, 0.0, 0.15, 0.3])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_delay_is_measured_within_a_bin(late_s: float, sign: float) -> None:
    found = turn_delay(gyro(), reference(20.0, late_s, sign))
    assert found is not None and found.std_s < 0.03
    # The headings of this reference come every 0.05 s, so that a turn is counted half of that late.
    assert found.delay_s == pytest.approx(late_s + 0.025, abs=0.03)


def test_the_standard_deviation_of_a_delay_is_that_of_its_scatter() -> None:
    rng, found = np.random.default_rng(3), []
    for _ in range(30):
        other = reference(20.0, 0.1)
        for number in other.bins_rad:
            other.bins_rad[number] += 0.06 * float(rng.standard_normal())
        delay = turn_delay(gyro(), other)
        assert delay is not None
        found.append((delay.delay_s, delay.std_s))
    delays_s, stds_s = np.array(found).T
    # What is left is in part that turns are not even within a bin, which is the same each time.
    assert 0.5 * stds_s.mean() < np.std(delays_s) < 1.2 * stds_s.mean()


def test_sensors_that_do_not_agree_have_no_delay() -> None:
    assert turn_delay(gyro(), reference(20.0, seed=2)) is None
    assert turn_delay(gyro(), TurnStats()) is None
    still = TurnStats()
    still.add(stamps_ns(20.0), np.zeros(len(stamps_ns(20.0))))
    assert turn_delay(gyro(), still) is None and turn_delay(still, gyro()) is None
