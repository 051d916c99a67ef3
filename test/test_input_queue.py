"""The input queue: sorted, and bounded whatever arrives."""

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
    """Yield the measurements of an IMU at 100 Hz and of wheels at 50 Hz."""
    for tick in range(round(from_s * 100), round(to_s * 100)):
        if imu:
            yield IMU, ImuSample(at(tick / 100), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
        if tick % 2 == 0:
            yield WHEELS, WheelSample(at(tick / 100 + 0.001), 0.1, 0.0)


def push(queue: InputQueue, items: Iterator[tuple[int, Measurement]]) -> list[Measurement]:
    """Push measurements at their stamps; return those that are released."""
    out: list[Measurement] = []
    for stream, item in items:
        queue.push(stream, (item,), item.t_ns)
        out += queue.waiting
        queue.waiting.clear()
    return out


def new_queue() -> InputQueue:
    return InputQueue(0.3, STEP_S, (IMU, WHEELS))


def test_measurements_are_dropped_while_the_imu_is_silent_for_long() -> None:
    queue = new_queue()
    push(queue, sensors(0.0, 5.0))
    out = push(queue, sensors(5.0, 60.0, imu=False))
    assert max(item.t_ns for item in out) <= at(5.0) + MAX_SILENCE_NS
    assert queue.without_imu[WHEELS] > 2000
    after = push(queue, sensors(60.0, 61.0))
    assert isinstance(after[0], ClockStep), 'a new time base begins when it is back'
    assert after[0].step_ns == 0
    assert ['gap of 55.0 s' in event for event in queue.events] == [True]


def test_before_the_first_imu_sample_few_measurements_are_kept() -> None:
    queue = new_queue()
    out = push(queue, sensors(0.0, 60.0, imu=False))
    assert len(out) < 700
    after = push(queue, sensors(60.0, 61.0))
    assert isinstance(after[0], ClockStep)
    assert not queue.events


def test_a_short_gap_is_reported_and_nothing_is_dropped() -> None:
    queue = new_queue()
    out = push(queue, sensors(0.0, 5.0)) + push(queue, sensors(5.0, 5.8, imu=False))
    out += push(queue, sensors(5.8, 8.0))
    assert not any(isinstance(item, ClockStep) for item in out)
    assert not queue.without_imu
    assert queue.events == ['imu/data_raw: gap of 0.8 s']


def test_the_queue_is_bounded() -> None:
    queue = new_queue()
    for stream, item in sensors(0.0, 150.0):
        queue.push(stream, (item,), item.t_ns)
    assert len(queue.waiting) == MAX_WAITING
    assert queue.waiting[-1].t_ns > at(149.0)


def test_finish_releases_everything() -> None:
    queue = new_queue()
    items = list(sensors(0.0, 1.0))
    for stream, item in items:
        queue.push(stream, (item,), item.t_ns)
    queue.finish()
    assert len(queue.waiting) == len(items)
