"""What arrives waits in order, and never without end."""

from __future__ import annotations

from collections.abc import Iterator

from gyrocal_ros.data import (
    NS_PER_S,
    ClockStep,
    ImuSample,
    Measurement,
    WheelSample,
    nanoseconds,
)
from gyrocal_ros.robot.input_queue import MAX_SILENCE_NS, MAX_WAITING, STEP_S, InputQueue

IMU, WHEELS = 0, 1
START_NS = 1_700_000_000 * NS_PER_S


def at(time_s: float) -> int:
    return START_NS + nanoseconds(time_s)


def sensors(from_s: float, to_s: float, *, imu: bool = True) -> Iterator[tuple[int, Measurement]]:
    """An IMU at 100 Hz, wheels at 50 Hz."""
    for tick in range(round(from_s * 100), round(to_s * 100)):
        if imu:
            yield IMU, ImuSample(at(tick / 100), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
        if tick % 2 == 0:
            yield WHEELS, WheelSample(at(tick / 100 + 0.001), 0.1, 0.0)


def push(intake: InputQueue, items: Iterator[tuple[int, Measurement]]) -> list[Measurement]:
    """Let them come when they are measured; return what is handed on."""
    out: list[Measurement] = []
    for stream, item in items:
        intake.push(stream, (item,), item.t_ns)
        out += intake.waiting
        intake.waiting.clear()
    return out


def intake() -> InputQueue:
    return InputQueue(0.3, STEP_S, (IMU, WHEELS))


def test_nothing_is_kept_for_an_imu_that_stays_away() -> None:
    new = intake()
    push(new, sensors(0.0, 5.0))
    out = push(new, sensors(5.0, 60.0, imu=False))
    assert max(item.t_ns for item in out) <= at(5.0) + MAX_SILENCE_NS
    assert new.useless[WHEELS] > 2000
    after = push(new, sensors(60.0, 61.0))
    assert isinstance(after[0], ClockStep), 'when it is back, a new time base begins'
    assert after[0].step_ns == 0
    assert ['there was a gap of 55.0 s' in event for event in new.events] == [True]


def test_an_imu_that_comes_late_finds_little_waiting() -> None:
    new = intake()
    out = push(new, sensors(0.0, 60.0, imu=False))
    assert len(out) < 700
    after = push(new, sensors(60.0, 61.0))
    assert isinstance(after[0], ClockStep)
    assert not new.events


def test_a_short_gap_is_told_and_nothing_is_lost() -> None:
    new = intake()
    out = push(new, sensors(0.0, 5.0)) + push(new, sensors(5.0, 5.8, imu=False))
    out += push(new, sensors(5.8, 8.0))
    assert not any(isinstance(item, ClockStep) for item in out)
    assert not new.useless
    assert new.events == ['imu/data_raw: there was a gap of 0.8 s']


def test_what_nobody_takes_is_bounded() -> None:
    new = intake()
    for stream, item in sensors(0.0, 150.0):
        new.push(stream, (item,), item.t_ns)
    assert len(new.waiting) == MAX_WAITING
    assert new.waiting[-1].t_ns > at(149.0)


def test_at_the_end_all_is_handed_on() -> None:
    new = intake()
    items = list(sensors(0.0, 1.0))
    for stream, item in items:
        new.push(stream, (item,), item.t_ns)
    new.finish()
    assert len(new.waiting) == len(items)
