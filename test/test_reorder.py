"""Messages are released in the order of their stamps, and steps of the clock are detected."""

from __future__ import annotations

import random
from collections.abc import Iterable
from typing import TypeAlias

import pytest

from gyrocal_ros.data import NS_PER_S, ClockStep
from gyrocal_ros.msgs.reorder import Drop, Reorderer

MS = NS_PER_S // 1000
WINDOW, STEP = 100 * MS, 5 * NS_PER_S
Message: TypeAlias = tuple[int, int]
"""Stamp and stream; the item is the stamp."""


def sort(messages: Iterable[Message], window: int = WINDOW) -> tuple[list[int | ClockStep], Reorderer[int]]:
    reorderer = Reorderer[int](window, STEP)
    out = [item for t_ns, stream in messages for item in reorderer.push(t_ns, stream, t_ns)]
    return out + list(reorderer.finish()), reorderer


def steady(start_ms: int, end_ms: int, every_ms: int = 5, stream: int = 0) -> list[Message]:
    return [(t * MS, stream) for t in range(start_ms, end_ms, every_ms)]


@pytest.mark.parametrize('seed', range(20))
def test_late_messages_are_sorted_in_within_the_window(seed: int) -> None:
    rng = random.Random(seed)
    messages = steady(0, 2000, 5, 0) + steady(1, 2000, 20, 1) + steady(2, 2000, 66, 2)
    delayed = sorted(messages, key=lambda message: message[0] + rng.randrange(0, WINDOW))
    out, reorderer = sort(delayed)
    assert out == sorted(t_ns for t_ns, _ in messages)
    assert not reorderer.drops


@pytest.mark.parametrize('seed', range(20))
def test_for_random_input_the_output_is_sorted_and_every_message_accounted_for(seed: int) -> None:
    rng = random.Random(seed)
    messages = [(rng.randrange(0, 4 * NS_PER_S, MS), rng.randrange(3)) for _ in range(1000)]
    out, reorderer = sort(messages)
    assert out == sorted(item for item in out if isinstance(item, int))
    assert len(out) + sum(reorderer.drops.values()) == len(messages)


def test_messages_later_than_the_window_are_dropped_and_counted() -> None:
    messages = steady(0, 1000)
    messages.insert(150, (7 * MS, 1))
    out, reorderer = sort(messages)
    assert 7 * MS not in out
    assert reorderer.drops == {(Drop.LATE, 1): 1}


def test_repeated_stamps_are_dropped_within_a_stream_but_not_across_streams() -> None:
    messages = [*steady(0, 100), (50 * MS, 0), (95 * MS, 0), (95 * MS, 1)]
    out, reorderer = sort(messages)
    assert out.count(95 * MS) == 2
    assert reorderer.drops == {(Drop.DUPLICATE, 0): 2}


def test_equal_stamps_are_released_in_the_order_of_their_streams() -> None:
    reorderer = Reorderer[str](WINDOW, STEP)
    for stream in (2, 0, 1):
        assert not reorderer.push(0, stream, f'stream {stream}')
    assert list(reorderer.finish()) == ['stream 0', 'stream 1', 'stream 2']


@pytest.mark.parametrize('outlier_ms', [0, 90_000, -90_000])
def test_a_single_outlier_is_dropped_and_is_no_step(outlier_ms: int) -> None:
    messages = steady(10_000, 12_000)
    messages.insert(200, (outlier_ms * MS, 3))
    out, reorderer = sort(messages)
    assert out == [t_ns for t_ns, _ in steady(10_000, 12_000)]
    assert reorderer.drops == {(Drop.OUTLIER, 3): 1}


def test_an_outlier_at_the_start_is_dropped_and_is_no_step() -> None:
    out, reorderer = sort([(0, 1), *steady(100_000, 102_000)])
    assert out == [t_ns for t_ns, _ in steady(100_000, 102_000)]
    assert reorderer.drops == {(Drop.OUTLIER, 1): 1}


@pytest.mark.parametrize('step_s', [100, -100])
def test_a_lasting_jump_starts_a_new_time_base(step_s: int) -> None:
    before = steady(200_000, 202_000, 5, 0) + steady(200_001, 202_000, 20, 1)
    after = steady(202_000, 204_000, 5, 0) + steady(202_001, 204_000, 20, 1)
    moved = sorted((t_ns + step_s * NS_PER_S, stream) for t_ns, stream in after)
    out, reorderer = sort(sorted(before) + moved)
    first = moved[0][0]
    step = ClockStep(first, first - max(before)[0])
    assert out == [*(t_ns for t_ns, _ in sorted(before)), step, *(t_ns for t_ns, _ in moved)]
    assert not reorderer.drops


def by_arrival(messages: Iterable[tuple[int, int, int]]) -> tuple[list[int | ClockStep], Reorderer[int]]:
    """Sort messages of stamp, stream and time of arrival (ms)."""
    reorderer = Reorderer[int](WINDOW, STEP)
    out: list[int | ClockStep] = []
    for t_ms, stream, arrival_ms in sorted(messages, key=lambda message: message[2]):
        out += reorderer.push(t_ms * MS, stream, t_ms, arrival_ms * MS)
    return out + list(reorderer.finish()), reorderer


def test_a_step_back_by_seconds_is_seen_where_the_arrival_is_known() -> None:
    times = range(10_000, 16_000, 5)
    stepped = [(t if t < 13_000 else t - 3000, 0, t + 2) for t in times]
    images = [(t + 1 if t < 13_000 else t - 2999, 1, t + 40) for t in times if t % 50 == 0]
    out, reorderer = by_arrival(stepped + images)
    (step,) = [item for item in out if isinstance(item, ClockStep)]
    assert step.step_ns == pytest.approx(-3000 * MS, abs=50 * MS)
    place = out.index(step)
    assert out[:place] == sorted(out[:place]) and out[place + 1 :] == sorted(out[place + 1 :])  # type: ignore[type-var]
    assert len(out) - 1 == len(stepped) + len(images) and not reorderer.drops


def test_one_stream_that_is_seconds_late_is_no_step() -> None:
    times = range(10_000, 16_000, 5)
    steady_ms = [(t, 0, t + 2) for t in times]
    late = [(t + 1, 1, t + 2000) for t in times if t % 50 == 0 and t < 14_000]
    out, reorderer = by_arrival(steady_ms + late)
    assert not any(isinstance(item, ClockStep) for item in out)
    assert reorderer.drops == {(Drop.LATE, 1): len(late)}
    assert out == list(times)


def test_late_messages_from_before_the_step_do_not_hide_it() -> None:
    before, after = steady(0, 2000), steady(102_000, 104_000)
    late = [(t_ns, 2) for t_ns in (1990 * MS, 1994 * MS, 1998 * MS)]
    for place, message in enumerate(late):
        after.insert(10 + 10 * place, message)
    out, reorderer = sort(before + after)
    assert [type(item) for item in out].count(ClockStep) == 1
    assert {t_ns for t_ns, _ in late} <= set(out)
    assert not reorderer.drops


def test_a_jump_of_one_stream_alone_is_no_step() -> None:
    together = sorted(steady(0, 4000, 5, 0) + steady(1, 4000, 20, 1))
    jumped = [
        (t_ns + 60 * NS_PER_S, 0) if stream == 0 and t_ns > NS_PER_S else (t_ns, stream)
        for t_ns, stream in together
    ]
    out, reorderer = sort(jumped)
    assert not any(isinstance(item, ClockStep) for item in out)
    assert set(reorderer.drops) == {(Drop.OUTLIER, 0)}
    assert [item for item in out if isinstance(item, int) and item % (5 * MS)] == [
        t_ns for t_ns, stream in together if stream == 1
    ]


def test_memory_does_not_grow_with_the_recording() -> None:
    reorderer = Reorderer[int](WINDOW, STEP)
    buffered = most_buffered = 0
    for t_ns, stream in steady(0, 20_000):
        buffered += 1 - len(reorderer.push(t_ns, stream, t_ns))
        most_buffered = max(most_buffered, buffered)
    assert most_buffered <= 1 + (WINDOW + WINDOW // 4) // (5 * MS)


def live(
    step_s: float, *, at_ms: int = 4000, pause_ms: int = 0
) -> tuple[list[int | ClockStep], Reorderer[int]]:
    """Sort messages that arrive on time: a first part, an optional pause, then stamps that have jumped."""
    reorderer = Reorderer[int](WINDOW, NS_PER_S // 2)
    before = steady(10_000, 10_000 + at_ms)
    after = steady(10_000 + at_ms + pause_ms, 12_000 + at_ms + pause_ms)
    out: list[int | ClockStep] = []
    for t_ns, stream in before:
        out += reorderer.push(t_ns, stream, t_ns, arrival_ns=t_ns)
    for t_ns, stream in after:
        stamp_ns = t_ns + round(step_s * NS_PER_S)
        out += reorderer.push(stamp_ns, stream, stamp_ns, arrival_ns=t_ns)
    return out + list(reorderer.finish()), reorderer


@pytest.mark.parametrize('step_s', [-2.0, -0.7, 0.7, 2.0])
def test_a_small_jump_is_detected_by_the_time_of_arrival(step_s: float) -> None:
    out, reorderer = live(step_s)
    steps = [item for item in out if isinstance(item, ClockStep)]
    assert [step.step_ns for step in steps] == [round(step_s * NS_PER_S)]
    assert not reorderer.drops


def test_a_pause_of_all_sensors_is_no_step() -> None:
    out, reorderer = live(0.0, pause_ms=20_000)
    assert not any(isinstance(item, ClockStep) for item in out)
    assert not reorderer.drops


def test_a_jump_within_a_pause_is_detected() -> None:
    out, _ = live(3.0, pause_ms=5_000)
    assert [item.step_ns for item in out if isinstance(item, ClockStep)] == [3 * NS_PER_S]


def test_messages_that_arrive_together_after_a_stall_are_no_step() -> None:
    reorderer = Reorderer[int](WINDOW, NS_PER_S // 2)
    out: list[int | ClockStep] = []
    for t_ns, stream in steady(0, 10_000):
        late = 4000 * MS <= t_ns < 7000 * MS
        out += reorderer.push(t_ns, stream, t_ns, arrival_ns=7000 * MS if late else t_ns)
    assert out + list(reorderer.finish()) == [t_ns for t_ns, _ in steady(0, 10_000)]
    assert not reorderer.drops


@pytest.mark.parametrize('outlier_ms', [-700, 700])
def test_stamps_that_reach_an_outlier_are_no_step(outlier_ms: int) -> None:
    reorderer = Reorderer[int](WINDOW, NS_PER_S // 2)
    out: list[int | ClockStep] = []
    for t_ns, stream in steady(0, 8000):
        out += reorderer.push(t_ns, stream, t_ns, arrival_ns=t_ns)
        if t_ns == 4000 * MS:
            out += reorderer.push(t_ns + outlier_ms * MS + 1, 1, 0, arrival_ns=t_ns)
    assert out + list(reorderer.finish()) == [t_ns for t_ns, _ in steady(0, 8000)]
    assert reorderer.drops == {(Drop.OUTLIER, 1): 1}


def test_streams_with_queues_of_different_length_after_a_stall_are_no_step() -> None:
    reorderer = Reorderer[int](WINDOW, NS_PER_S // 2)
    fast, slow = steady(0, 4000, 5, 0), steady(2, 4000, 20, 1)
    before = sorted(message for message in [*fast, *slow] if message[0] < 1000 * MS)
    out: list[int | ClockStep] = []
    for t_ns, stream in before:
        out += reorderer.push(t_ns, stream, t_ns, arrival_ns=t_ns + 1)
    kept_fast = [message for message in fast if message[0] >= 3000 * MS]
    kept_slow = [message for message in slow if message[0] >= 1000 * MS]
    for k in range(150):  # the queue of the fast stream covers less time
        for t_ns, stream in (kept_fast[k], kept_slow[k]):
            out += reorderer.push(t_ns, stream, t_ns, arrival_ns=4000 * MS + k * MS)
    assert not any(isinstance(item, ClockStep) for item in [*out, *reorderer.finish()])


# --- punctual streams ---------------------------------------------------------------------------


def arrive(messages: Iterable[tuple[int, int, int]]) -> tuple[list[tuple[int, int]], Reorderer[int]]:
    """Return the released stamps with their latency (ms), for messages of stamp, stream and delay (ms).

    Streams 0 and 1 are punctual, stream 2 is not.
    """
    reorderer = Reorderer[int](WINDOW, STEP, punctual=(0, 1))
    out = []
    for t_ms, stream, delay_ms in sorted(messages, key=lambda message: message[0] + message[2]):
        for item in reorderer.push(t_ms * MS, stream, t_ms):
            assert isinstance(item, int)
            out.append((item, t_ms + delay_ms - item))
    return out, reorderer


def test_messages_are_released_once_all_punctual_streams_have_passed_them() -> None:
    fast = [(t, 0, 2) for t in range(0, 1000, 5)]
    images = [(t, 1, 30) for t in range(1, 1000, 50)]
    out, reorderer = arrive(fast + images)
    assert [t for t, _ in out] == sorted(t for t, _ in out)
    assert not reorderer.drops
    assert {late for t, late in out if t % 5 == 1} == {30}, 'an image is released on arrival'
    assert max(late for t, late in out if t > 100) <= 30 + 25, 'the others wait for the next image, no longer'
    follow_ms = [out[k + 1][1] + out[k + 1][0] - t - 30 for k, (t, _) in enumerate(out[:-1]) if t % 5 == 1]
    assert follow_ms[3:] == [0] * len(follow_ms[3:]), 'the message after an image is released with it'


def test_a_punctual_stream_that_stops_delays_the_others_by_the_window_at_most() -> None:
    fast = [(t, 0, 2) for t in range(0, 1000, 5)]
    images = [(t, 1, 30) for t in range(1, 400, 50)]
    out, reorderer = arrive(fast + images)
    assert [t for t, _ in out] == sorted(t for t, _ in out) and not reorderer.drops
    late_ms = [late for t, late in out if t > 500]
    assert min(late_ms) >= 100 and max(late_ms) <= 100 + 25 + 2


def test_a_stream_that_is_not_punctual_may_be_late_within_the_window() -> None:
    fast = [(t, 0, 2) for t in range(0, 1000, 5)]
    images = [(t, 1, 30) for t in range(1, 1000, 50)]
    slow = [(203, 2, 60), (303, 2, 130), (403, 2, 100), (353, 2, 90)]
    out, reorderer = arrive(fast + images + slow)
    assert [t for t, _ in out if t % 50 == 3] == [203, 353, 403]
    assert reorderer.drops == {(Drop.LATE, 2): 1}


def test_a_message_of_a_punctual_stream_out_of_order_is_dropped() -> None:
    fast = [(t, 0, 2) for t in range(0, 1000, 5)]
    images = [(t, 1, 30) for t in range(1, 1000, 50)]
    out, reorderer = arrive([*fast, *images, (502, 0, 80)])
    assert 502 not in [t for t, _ in out]
    assert reorderer.drops == {(Drop.LATE, 0): 1}


@pytest.mark.parametrize('ahead_ms', [-90_000, -2_000, 2_000, 90_000])
def test_a_follower_with_a_wrong_clock_makes_no_other_message_late(ahead_ms: int) -> None:
    """A ground truth two seconds ahead must not empty the stream of the gyro."""
    leading = steady(10_000, 14_000)
    reorderer = Reorderer[int](WINDOW, STEP, followers=[3])
    out: list[int | ClockStep] = []
    for t_ns, stream in leading:
        out += reorderer.push(t_ns + ahead_ms * MS, 3, 0)
        out += reorderer.push(t_ns, stream, t_ns)
    out += reorderer.finish()
    assert [item for item in out if item] == [t_ns for t_ns, _ in leading]
    assert {stream for _, stream in reorderer.drops} <= {3}
