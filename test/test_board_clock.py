"""Stamps follow the true measurement time, whatever the delays of the arrivals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import pytest

from gyrocal_ros.board.clock import Clock, RestartCause, Stamp, lower_hull, middle_slope
from gyrocal_ros.data import NS_PER_S, Array, IntArray, nanoseconds

START_NS = 1_700_000_000_000_000_000
MS = NS_PER_S // 1000
SETTLED_S = 10.0
"""Time from the start until enough fast arrivals have been received."""
US_WRAP = 1 << 32

Jitter: TypeAlias = Callable[[np.random.Generator, IntArray], Array]
"""Draws the delays (s) of the frames measured at these times (ns)."""


def uniform(rng: np.random.Generator, true_ns: IntArray) -> Array:
    return rng.uniform(0.0, 0.02, len(true_ns))


def rarely_fast(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """Draw delays of mostly about 10 ms, rarely less than one."""
    return np.minimum(rng.gamma(2.0, 0.005, len(true_ns)), 0.04)


def mostly_fast(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """Draw the delays of a USB line on a busy machine: short, with far outliers."""
    return rng.exponential(0.001, len(true_ns)) + 0.2 * (rng.random(len(true_ns)) < 0.02)


def batched(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """Draw the delays of a USB adapter that forwards its buffer every 16 ms."""
    period_ns = 16 * MS + 137_000
    return (period_ns - true_ns % period_ns) / NS_PER_S + rng.uniform(0.0, 0.0005, len(true_ns))


@dataclass(frozen=True)
class Arrivals:
    """Measurements of a board and the arrivals of their frames."""

    true_ns: IntArray
    time_us: IntArray
    arrival_ns: IntArray

    def followed_by(self, *others: Arrivals) -> Arrivals:
        parts = (self, *others)
        return Arrivals(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(self)))


def arrivals(
    duration_s: float,
    jitter: Jitter = uniform,
    *,
    from_s: float = 0.0,
    board_s: float = 100.0,
    drift: float = 5e-5,
    rate_hz: float = 200.0,
    seed: int = 1,
) -> Arrivals:
    """Return arrivals from a board whose clock reads `board_s` at `from_s` and loses `drift` on the host."""
    since_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    true_ns = START_NS + nanoseconds(from_s) + np.round(since_s * NS_PER_S).astype(np.int64)
    time_us = np.round((board_s + since_s / (1.0 + drift)) * 1e6).astype(np.int64) % US_WRAP
    delay_s = jitter(np.random.default_rng(seed), true_ns)
    # Frames arrive in the order in which they were sent.
    arrival_ns = np.maximum.accumulate(true_ns + np.round(delay_s * NS_PER_S).astype(np.int64))
    return Arrivals(true_ns, time_us, arrival_ns)


def all_stamps(clock: Clock, received: Arrivals) -> list[Stamp | None]:
    return [
        clock.stamp(int(us), int(ns)) for us, ns in zip(received.time_us, received.arrival_ns, strict=True)
    ]


def stamps_ns(clock: Clock, received: Arrivals) -> IntArray:
    """Return the stamps of a line without outliers."""
    return np.array([stamp.t_ns for stamp in all_stamps(clock, received) if stamp], dtype=np.int64)


def errors_ms(clock: Clock, received: Arrivals) -> Array:
    return (stamps_ns(clock, received) - received.true_ns) / MS


def settled(received: Arrivals, since_s: float = 0.0) -> Array:
    return (received.true_ns - received.true_ns[0]) / NS_PER_S >= since_s + SETTLED_S


@pytest.mark.parametrize('jitter', [uniform, mostly_fast, batched])
@pytest.mark.parametrize(('seed', 'drift'), [(1, -1e-4), (2, 0.0), (3, 5e-5), (4, 1e-4)])
def test_stamps_are_within_a_millisecond_of_the_true_time(jitter: Jitter, seed: int, drift: float) -> None:
    received = arrivals(90.0, jitter, drift=drift, seed=seed)
    clock = Clock()
    errors = errors_ms(clock, received)
    assert np.abs(errors[settled(received)]).max() < 1.0
    assert clock.drift == pytest.approx(drift, abs=2e-5)
    assert not clock.restarts and not clock.outliers


@pytest.mark.parametrize('seed', range(4))
def test_rare_fast_arrivals_need_a_longer_settling_time(seed: int) -> None:
    received = arrivals(90.0, rarely_fast, seed=seed)
    errors = errors_ms(Clock(), received)
    assert np.abs(errors[settled(received)]).max() < 2.5
    assert np.abs(errors[settled(received, since_s=20.0)]).max() < 1.0


def test_the_clock_removes_the_jitter() -> None:
    received = arrivals(30.0)
    raw_ms = (received.arrival_ns - received.true_ns) / MS
    assert raw_ms.max() > 19.0
    assert np.abs(errors_ms(Clock(), received)[settled(received)]).mean() < 0.05 * raw_ms.mean()


@pytest.mark.parametrize('seed', range(5))
def test_stamps_increase_from_the_first_one_on(seed: int) -> None:
    stamps = stamps_ns(Clock(), arrivals(10.0, seed=seed))
    assert (np.diff(stamps) > 0).all()


def test_the_drift_of_a_warming_crystal_is_tracked() -> None:
    received = arrivals(120.0, drift=0.0)
    since_s = (received.true_ns - received.true_ns[0]) / NS_PER_S
    gained_us = 20e-6 * 60.0 * (since_s / 60.0 + np.expm1(-since_s / 60.0)) * 1e6
    warming = Arrivals(
        received.true_ns,
        (received.time_us - np.round(gained_us).astype(np.int64)) % US_WRAP,
        received.arrival_ns,
    )
    assert np.abs(errors_ms(Clock(), warming)[settled(received)]).max() < 1.0


def test_the_delay_of_the_fastest_frame_is_a_parameter() -> None:
    received = arrivals(10.0)
    late = Arrivals(received.true_ns, received.time_us, received.arrival_ns + 3 * MS)
    assert np.array_equal(stamps_ns(Clock(fastest_ns=3 * MS), late), stamps_ns(Clock(), received))


def test_the_counter_wraps() -> None:
    received = arrivals(20.0, board_s=US_WRAP / 1e6 - 10.0)
    assert received.time_us.min() < 1e7 < received.time_us.max()
    assert np.array_equal(stamps_ns(Clock(), received), stamps_ns(Clock(), arrivals(20.0)))


def test_a_pause_longer_than_the_counter_period_keeps_the_time_base() -> None:
    away_s = 3.0 * 3600.0
    before, after = (
        arrivals(40.0),
        arrivals(20.0, from_s=away_s, board_s=100.0 + away_s / (1.0 + 5e-5), seed=2),
    )
    clock = Clock()
    errors = errors_ms(clock, before.followed_by(after))
    assert np.abs(errors[len(before.true_ns) :][settled(after)]).max() < 1.0
    assert not clock.restarts


@pytest.mark.parametrize('uptime_s', [3.0, 100.0, 2000.0, 3000.0, 4290.0, 10_000.0])
def test_a_restart_of_the_board_begins_a_new_time_base(uptime_s: float) -> None:
    before, after = arrivals(20.0, board_s=uptime_s), arrivals(20.0, from_s=23.0, board_s=0.3, seed=2)
    clock = Clock()
    all_stamps(clock, before)
    first, *rest = all_stamps(clock, after)
    assert first is None
    assert clock.restarts == {RestartCause.BOARD: 1} and clock.outliers == 1
    assert {stamp.base for stamp in rest if stamp} == {1}
    errors = np.array([stamp.t_ns for stamp in rest if stamp]) - after.true_ns[1:]
    assert np.abs(errors[settled(after)[1:]]).max() < MS


def test_stamps_increase_over_a_restart_of_the_board() -> None:
    received = arrivals(5.0).followed_by(
        arrivals(5.0, from_s=5.1, board_s=0.0, seed=2), arrivals(5.0, from_s=10.2, board_s=0.0)
    )
    clock = Clock()
    assert (np.diff(stamps_ns(clock, received)) > 0).all()
    assert clock.restarts == {RestartCause.BOARD: 2}


@pytest.mark.parametrize('outlier_us', [0, 50_000_000, 2_000_000_000, US_WRAP - 1])
def test_an_outlying_board_time_is_rejected(outlier_us: int) -> None:
    received = arrivals(10.0)
    clock = Clock()
    all_stamps(clock, received)
    arrival_ns = int(received.arrival_ns[-1])
    assert clock.stamp(outlier_us, arrival_ns) is None
    assert clock.stamp((outlier_us + 3_000_000_000) % US_WRAP, arrival_ns + MS) is None
    assert clock.outliers == 2
    after = clock.stamp(int(received.time_us[-1]) + 25_000, arrival_ns + 25 * MS)
    assert after is not None and after.base == 0
    assert abs(after.t_ns - int(received.true_ns[-1]) - 25 * MS) < MS


def test_a_backlog_is_stamped_with_its_measurement_times() -> None:
    received = arrivals(30.0)
    stalled = (received.true_ns >= START_NS + 10 * NS_PER_S) & (received.true_ns < START_NS + 16 * NS_PER_S)
    arrival_ns = np.where(stalled, START_NS + 16 * NS_PER_S, received.arrival_ns)
    arrival_ns[np.argmax(stalled) - 1] += 100 * MS  # the last frame before the stall is already delayed
    clock = Clock()
    errors = errors_ms(clock, Arrivals(received.true_ns, received.time_us, np.maximum.accumulate(arrival_ns)))
    assert np.abs(errors[settled(received)]).max() < 1.0
    assert not clock.restarts


def test_a_slow_backlog_is_not_mistaken_for_a_clock_step() -> None:
    received = arrivals(40.0)
    stalled = (received.true_ns >= START_NS + 10 * NS_PER_S) & (received.true_ns < START_NS + 27 * NS_PER_S)
    # Transmitted three times as fast as it was measured, from 12 s after the start of the stall.
    drained_ns = START_NS + 22 * NS_PER_S + (received.true_ns - START_NS - 10 * NS_PER_S) // 3
    arrival_ns = np.where(stalled, np.maximum(received.arrival_ns, drained_ns), received.arrival_ns)
    clock = Clock()
    errors = errors_ms(clock, Arrivals(received.true_ns, received.time_us, np.maximum.accumulate(arrival_ns)))
    assert not clock.restarts
    late = received.true_ns > START_NS + 30 * NS_PER_S
    assert np.abs(errors[stalled]).max() < 2.0  # the drift was estimated from ten seconds only
    assert np.abs(errors[late]).max() < 1.0


@pytest.mark.parametrize('step_s', [2.0, -2.0, 3600.0, -3600.0])
def test_a_step_of_the_host_clock_begins_a_new_time_base(step_s: float) -> None:
    before, after = arrivals(20.0), arrivals(20.0, from_s=20.0, board_s=100.0 + 20.0 / (1.0 + 5e-5), seed=2)
    step_ns = nanoseconds(step_s)
    clock = Clock()
    all_stamps(clock, before)
    stamps = all_stamps(clock, Arrivals(after.true_ns, after.time_us, after.arrival_ns + step_ns))
    assert clock.restarts.total() == 1
    late = settled(after, since_s=2.0)
    found = [(stamp, true) for stamp, true, good in zip(stamps, after.true_ns, late, strict=True) if good]
    assert all(stamp and stamp.base == 1 and abs(stamp.t_ns - true - step_ns) < MS for stamp, true in found)
    ours = [stamp.t_ns for stamp in stamps if stamp]
    assert all(a < b for a, b in pairwise(ours))


def test_the_hull_is_below_all_points_and_its_middle_edge_has_their_slope() -> None:
    rng = np.random.default_rng(3)
    points = [(x, 2 * x + int(rng.integers(0, 1000))) for x in range(0, 10_000, 10)]
    hull = lower_hull(points)
    (xs, ys), all_points = np.array(hull, dtype=float).T, np.array(points, dtype=float)
    assert (np.interp(all_points[:, 0], xs, ys) <= all_points[:, 1] + 1e-6).all()
    assert set(hull) <= set(points)
    assert middle_slope(hull) == pytest.approx(2.0, abs=0.02)
