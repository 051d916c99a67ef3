"""Stamps follow the true board time, whatever the way from the board does to the arrivals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import pytest

from gyrocal_ros.board.clock import Clock, Restart, Stamp, lower_hull, middle_slope
from gyrocal_ros.data import NS_PER_S, Array, IntArray, nanoseconds

START_NS = 1_700_000_000_000_000_000
MS = NS_PER_S // 1000
SETTLED_S = 10.0
"""From the start until enough fast arrivals have come."""
US_WRAP = 1 << 32

Jitter: TypeAlias = Callable[[np.random.Generator, IntArray], Array]
"""Draws how long (s) the frames measured at these times (ns) are on their way."""


def uniform(rng: np.random.Generator, true_ns: IntArray) -> Array:
    return rng.uniform(0.0, 0.02, len(true_ns))


def rarely_fast(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """Most take some 10 ms, few take less than one."""
    return np.minimum(rng.gamma(2.0, 0.005, len(true_ns)), 0.04)


def mostly_fast(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """As a USB line on a busy machine: quick, with outliers far beyond."""
    return rng.exponential(0.001, len(true_ns)) + 0.2 * (rng.random(len(true_ns)) < 0.02)


def by_the_batch(rng: np.random.Generator, true_ns: IntArray) -> Array:
    """As a USB adapter that hands on what it has every 16 ms."""
    period_ns = 16 * MS + 137_000
    return (period_ns - true_ns % period_ns) / NS_PER_S + rng.uniform(0.0, 0.0005, len(true_ns))


@dataclass(frozen=True)
class Line:
    """Measurements of a board and the arrivals of their frames."""

    true_ns: IntArray
    time_us: IntArray
    arrival_ns: IntArray

    def then(self, *others: Line) -> Line:
        lines = (self, *others)
        return Line(*(np.concatenate([getattr(line, name) for line in lines]) for name in vars(self)))


def line(
    duration_s: float,
    jitter: Jitter = uniform,
    *,
    from_s: float = 0.0,
    board_s: float = 100.0,
    drift: float = 5e-5,
    rate_hz: float = 200.0,
    seed: int = 1,
) -> Line:
    """A board whose clock reads `board_s` at `from_s`; the arrivals' clock gains `drift` on it."""
    since_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    true_ns = START_NS + nanoseconds(from_s) + np.round(since_s * NS_PER_S).astype(np.int64)
    time_us = np.round((board_s + since_s / (1.0 + drift)) * 1e6).astype(np.int64) % US_WRAP
    delay_s = jitter(np.random.default_rng(seed), true_ns)
    # What was sent first comes first.
    arrival_ns = np.maximum.accumulate(true_ns + np.round(delay_s * NS_PER_S).astype(np.int64))
    return Line(true_ns, time_us, arrival_ns)


def stamps_of(clock: Clock, came: Line) -> list[Stamp | None]:
    return [clock.stamp(int(us), int(ns)) for us, ns in zip(came.time_us, came.arrival_ns, strict=True)]


def stamped(clock: Clock, came: Line) -> IntArray:
    """Stamps of a line on which nothing is odd."""
    return np.array([stamp.t_ns for stamp in stamps_of(clock, came) if stamp], dtype=np.int64)


def errors_ms(clock: Clock, came: Line) -> Array:
    return (stamped(clock, came) - came.true_ns) / MS


def settled(came: Line, since_s: float = 0.0) -> Array:
    return (came.true_ns - came.true_ns[0]) / NS_PER_S >= since_s + SETTLED_S


@pytest.mark.parametrize('jitter', [uniform, mostly_fast, by_the_batch])
@pytest.mark.parametrize(('seed', 'drift'), [(1, -1e-4), (2, 0.0), (3, 5e-5), (4, 1e-4)])
def test_stamps_are_within_a_millisecond_of_the_true_time(jitter: Jitter, seed: int, drift: float) -> None:
    came = line(90.0, jitter, drift=drift, seed=seed)
    clock = Clock()
    errors = errors_ms(clock, came)
    assert np.abs(errors[settled(came)]).max() < 1.0
    assert clock.drift == pytest.approx(drift, abs=2e-5)
    assert not clock.restarts and not clock.odd


@pytest.mark.parametrize('seed', range(4))
def test_where_fast_arrivals_are_rare_it_takes_longer(seed: int) -> None:
    came = line(90.0, rarely_fast, seed=seed)
    errors = errors_ms(Clock(), came)
    assert np.abs(errors[settled(came)]).max() < 2.5
    assert np.abs(errors[settled(came, since_s=20.0)]).max() < 1.0


def test_jitter_is_what_the_clock_takes_out() -> None:
    came = line(30.0)
    raw_ms = (came.arrival_ns - came.true_ns) / MS
    assert raw_ms.max() > 19.0
    assert np.abs(errors_ms(Clock(), came)[settled(came)]).mean() < 0.05 * raw_ms.mean()


@pytest.mark.parametrize('seed', range(5))
def test_stamps_rise_from_the_first_one_on(seed: int) -> None:
    stamps = stamped(Clock(), line(10.0, seed=seed))
    assert (np.diff(stamps) > 0).all()


def test_a_crystal_that_warms_up_is_followed() -> None:
    came = line(120.0, drift=0.0)
    since_s = (came.true_ns - came.true_ns[0]) / NS_PER_S
    gained_us = 20e-6 * 60.0 * (since_s / 60.0 + np.expm1(-since_s / 60.0)) * 1e6
    warming = Line(
        came.true_ns, (came.time_us - np.round(gained_us).astype(np.int64)) % US_WRAP, came.arrival_ns
    )
    assert np.abs(errors_ms(Clock(), warming)[settled(came)]).max() < 1.0


def test_the_way_that_even_the_fastest_takes_is_a_parameter() -> None:
    came = line(10.0)
    late = Line(came.true_ns, came.time_us, came.arrival_ns + 3 * MS)
    assert np.array_equal(stamped(Clock(fastest_ns=3 * MS), late), stamped(Clock(), came))


def test_the_counter_wraps() -> None:
    came = line(20.0, board_s=US_WRAP / 1e6 - 10.0)
    assert came.time_us.min() < 1e7 < came.time_us.max()
    assert np.array_equal(stamped(Clock(), came), stamped(Clock(), line(20.0)))


def test_a_pause_longer_than_the_counter_is_bridged() -> None:
    away_s = 3.0 * 3600.0
    before, after = line(40.0), line(20.0, from_s=away_s, board_s=100.0 + away_s / (1.0 + 5e-5), seed=2)
    clock = Clock()
    errors = errors_ms(clock, before.then(after))
    assert np.abs(errors[len(before.true_ns) :][settled(after)]).max() < 1.0
    assert not clock.restarts


@pytest.mark.parametrize('uptime_s', [3.0, 100.0, 2000.0, 3000.0, 4290.0, 10_000.0])
def test_a_restart_of_the_board_is_survived(uptime_s: float) -> None:
    before, after = line(20.0, board_s=uptime_s), line(20.0, from_s=23.0, board_s=0.3, seed=2)
    clock = Clock()
    stamps_of(clock, before)
    first, *rest = stamps_of(clock, after)
    assert first is None
    assert clock.restarts == {Restart.BOARD: 1} and clock.odd == 1
    assert {stamp.base for stamp in rest if stamp} == {1}
    errors = np.array([stamp.t_ns for stamp in rest if stamp]) - after.true_ns[1:]
    assert np.abs(errors[settled(after)[1:]]).max() < MS


def test_stamps_rise_over_a_restart_of_the_board() -> None:
    came = line(5.0).then(line(5.0, from_s=5.1, board_s=0.0, seed=2), line(5.0, from_s=10.2, board_s=0.0))
    clock = Clock()
    assert (np.diff(stamped(clock, came)) > 0).all()
    assert clock.restarts == {Restart.BOARD: 2}


@pytest.mark.parametrize('wild_us', [0, 50_000_000, 2_000_000_000, US_WRAP - 1])
def test_a_wild_board_time_is_passed_over(wild_us: int) -> None:
    came = line(10.0)
    clock = Clock()
    stamps_of(clock, came)
    arrival_ns = int(came.arrival_ns[-1])
    assert clock.stamp(wild_us, arrival_ns) is None
    assert clock.stamp((wild_us + 3_000_000_000) % US_WRAP, arrival_ns + MS) is None
    assert clock.odd == 2
    after = clock.stamp(int(came.time_us[-1]) + 25_000, arrival_ns + 25 * MS)
    assert after is not None and after.base == 0
    assert abs(after.t_ns - int(came.true_ns[-1]) - 25 * MS) < MS


def test_a_backlog_is_stamped_when_it_was_measured() -> None:
    came = line(30.0)
    stalled = (came.true_ns >= START_NS + 10 * NS_PER_S) & (came.true_ns < START_NS + 16 * NS_PER_S)
    arrival_ns = np.where(stalled, START_NS + 16 * NS_PER_S, came.arrival_ns)
    arrival_ns[np.argmax(stalled) - 1] += 100 * MS  # the stall announces itself
    clock = Clock()
    errors = errors_ms(clock, Line(came.true_ns, came.time_us, np.maximum.accumulate(arrival_ns)))
    assert np.abs(errors[settled(came)]).max() < 1.0
    assert not clock.restarts


def test_a_backlog_that_takes_long_to_come_in_is_no_step_of_a_clock() -> None:
    came = line(40.0)
    stalled = (came.true_ns >= START_NS + 10 * NS_PER_S) & (came.true_ns < START_NS + 27 * NS_PER_S)
    # Three times as fast as it was measured, from 12 s after the stall on.
    drained_ns = START_NS + 22 * NS_PER_S + (came.true_ns - START_NS - 10 * NS_PER_S) // 3
    arrival_ns = np.where(stalled, np.maximum(came.arrival_ns, drained_ns), came.arrival_ns)
    clock = Clock()
    errors = errors_ms(clock, Line(came.true_ns, came.time_us, np.maximum.accumulate(arrival_ns)))
    assert not clock.restarts
    late = came.true_ns > START_NS + 30 * NS_PER_S
    assert np.abs(errors[stalled]).max() < 2.0  # ten seconds had told little of the drift
    assert np.abs(errors[late]).max() < 1.0


@pytest.mark.parametrize('step_s', [2.0, -2.0, 3600.0, -3600.0])
def test_a_step_of_the_clock_of_the_arrivals_begins_a_new_time_base(step_s: float) -> None:
    before, after = line(20.0), line(20.0, from_s=20.0, board_s=100.0 + 20.0 / (1.0 + 5e-5), seed=2)
    step_ns = nanoseconds(step_s)
    clock = Clock()
    stamps_of(clock, before)
    stamps = stamps_of(clock, Line(after.true_ns, after.time_us, after.arrival_ns + step_ns))
    assert clock.restarts.total() == 1
    late = settled(after, since_s=2.0)
    found = [(stamp, true) for stamp, true, good in zip(stamps, after.true_ns, late, strict=True) if good]
    assert all(stamp and stamp.base == 1 and abs(stamp.t_ns - true - step_ns) < MS for stamp, true in found)
    ours = [stamp.t_ns for stamp in stamps if stamp]
    assert all(a < b for a, b in pairwise(ours))


def test_the_hull_lies_below_all_points_and_its_middle_edge_follows_them() -> None:
    rng = np.random.default_rng(3)
    points = [(x, 2 * x + int(rng.integers(0, 1000))) for x in range(0, 10_000, 10)]
    hull = lower_hull(points)
    (xs, ys), line_y = np.array(hull, dtype=float).T, np.array(points, dtype=float)
    assert (np.interp(line_y[:, 0], xs, ys) <= line_y[:, 1] + 1e-6).all()
    assert set(hull) <= set(points)
    assert middle_slope(hull) == pytest.approx(2.0, abs=0.02)
