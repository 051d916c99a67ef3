"""Samples are buffered and cut into blocks: nothing is lost or counted twice, and gaps are reported."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from gyrocal_ros.data import (
    CovariateSample,
    ImuSample,
    MotionBlock,
    TemperatureSample,
    WheelSample,
    nanoseconds,
    seconds,
)
from gyrocal_ros.ekf.motion import GAP_NS, LEAD_PART, WHEEL_TIMEOUT_NS, MotionBuffer

START_NS = 1_700_000_000_000_000_000


def at(time_s: float) -> int:
    return START_NS + nanoseconds(time_s)


def imu(time_s: float, yaw_rate: float = 0.0) -> ImuSample:
    return ImuSample(at(time_s), (0.1, 0.2, yaw_rate), (time_s, 0.0, 9.8))


def wheels(time_s: float, speed: float = 0.0, yaw_rate: float = 0.0) -> WheelSample:
    return WheelSample(at(time_s), speed, yaw_rate)


def filled(
    duration_s: float = 1.0, speed: float = 0.0, imu_hz: int = 200, wheel_hz: int = 50
) -> MotionBuffer:
    buffer = MotionBuffer()
    for i in range(int(duration_s * imu_hz) + 1):
        buffer.add(imu(i / imu_hz))
    for i in range(int(duration_s * wheel_hz) + 1):
        buffer.add(wheels(i / wheel_hz, speed))
    return buffer


# --- IMU ----------------------------------------------------------------------------------------


def test_edges_are_interpolated() -> None:
    buffer = MotionBuffer()
    for time_s, rate in ((0.0, 0.0), (0.01, 0.1), (0.02, 0.3)):
        buffer.add(imu(time_s, rate))
    block = buffer.cut(at(0.004), at(0.015))
    np.testing.assert_allclose(block.dt_s, [0.006, 0.005])
    np.testing.assert_allclose(block.time_s, [0.007, 0.0125])
    lead_rad = LEAD_PART * 0.01 * (0.3 - 0.1)
    np.testing.assert_allclose(block.rate_rad_s[:, 2], np.array([0.07, 0.15]) - lead_rad / 0.011)
    np.testing.assert_allclose(block.specific_force_m_s2[:, 0], [0.007, 0.0125])
    assert block.duration_s == pytest.approx(0.011)
    assert block.gap_s == 0.0
    assert block.wheel_gap_s == pytest.approx(0.011)
    np.testing.assert_array_equal(block.distance_m, [0.0, 0.0])


def test_the_lead_ends_with_the_turn() -> None:
    """It is no part of the angle: over the whole turn it makes no difference."""
    rng, buffer = np.random.default_rng(3), MotionBuffer()
    imu_s = np.cumsum(rng.integers(2_000_000, 20_000_000, 400)) * 1e-9
    rates = np.concatenate([np.zeros(50), rng.normal(size=250), np.zeros(100)])
    for time_s, rate in zip(imu_s, rates, strict=True):
        buffer.add(imu(time_s, rate))
    cuts_s = np.sort(np.r_[imu_s[0], rng.uniform(imu_s[0], imu_s[-1], 40), imu_s[-1]])
    blocks = [buffer.cut(at(start_s), at(end_s)) for start_s, end_s in pairwise(cuts_s)]
    turned_rad = sum(float(block.rate_rad_s[:, 2] @ block.dt_s) for block in blocks)
    trapezoids_rad = 0.5 * (rates[1:] + rates[:-1]) @ np.diff(imu_s)
    assert turned_rad == pytest.approx(trapezoids_rad, abs=1e-9)


def test_blocks_partition_the_whole_turn_and_the_whole_distance() -> None:
    """Check trapezoids of the gyro less their lead, and steps of the wheels, for random times and cuts."""
    rng = np.random.default_rng(3)
    imu_s = np.cumsum(rng.integers(2_000_000, 20_000_000, 400)) * 1e-9
    rates = rng.normal(size=400)
    wheel_s = np.cumsum(rng.integers(10_000_000, 60_000_000, 100)) * 1e-9
    speeds = rng.normal(0.3, 0.1, 100)
    buffer = MotionBuffer()
    for t, rate in zip(imu_s, rates, strict=True):
        buffer.add(imu(t, rate))
    for t, speed in zip(wheel_s, speeds, strict=True):
        buffer.add(wheels(t, speed))
    end_s = min(imu_s[-1], wheel_s[-1])
    cuts = np.sort(np.concatenate([[imu_s[0], end_s], rng.uniform(imu_s[0], end_s, 60)]))
    blocks = [
        buffer.cut(at(start), at(end))
        for start, end in zip(cuts[:-1], cuts[1:], strict=True)
        if at(end) > at(start)
    ]

    def turned(until_s: float) -> float:
        grid = np.append(imu_s[imu_s < until_s], until_s)
        at_nodes = np.interp(grid, imu_s, rates)
        return float(0.5 * (at_nodes[1:] + at_nodes[:-1]) @ np.diff(grid))

    usual_s = seconds(GAP_NS)
    for longer_s in np.diff(imu_s):
        usual_s += (longer_s - usual_s) * (0.001 if longer_s > usual_s else 0.2)

    def lead(until_s: float) -> float:
        later = int(np.searchsorted(imu_s, until_s - 1e-10))
        if later == 0:
            return 0.0
        interval_s = imu_s[later] - imu_s[later - 1]
        return LEAD_PART * min(interval_s, usual_s) ** 2 * (rates[later] - rates[later - 1]) / interval_s

    def travelled(until_s: float) -> float:
        steps = np.concatenate([[0.0], speeds[1:] * np.diff(wheel_s)])
        return float(np.interp(until_s, wheel_s, np.cumsum(steps)))

    for block in blocks:
        start_s, end_s = seconds(block.start_ns - START_NS), seconds(block.end_ns - START_NS)
        assert block.dt_s.sum() == pytest.approx(end_s - start_s, abs=1e-12)
        expected_rad = turned(end_s) - lead(end_s) - (turned(start_s) - lead(start_s))
        assert block.rate_rad_s[:, 2] @ block.dt_s == pytest.approx(expected_rad, abs=1e-9)
        assert block.distance_m.sum() == pytest.approx(travelled(end_s) - travelled(start_s), abs=1e-9)


@pytest.mark.parametrize('is_mean', [False, True], ids=['the rate at the stamp', 'the mean about it'])
def test_the_turn_is_right_while_the_robot_accelerates(is_mean: bool) -> None:
    """Interpolated rates lead by an eighth or a twelfth of the squared interval times the acceleration."""
    interval_s, acceleration, final = 0.01, 7.0, 2.0

    def turned(time_s: float, start_s: float) -> float:
        rising_s = min(max(time_s - start_s, 0.0), final / acceleration)
        return 0.5 * acceleration * rising_s**2 + final * max(time_s - start_s - rising_s, 0.0)

    leads: list[float] = []
    at_end: list[float] = []
    for start_s in 0.1 + interval_s * np.arange(20) / 20.0:
        buffer, half_s = MotionBuffer(), 0.5 * interval_s if is_mean else 1e-6
        for i in range(100):
            before, after = (turned(i * interval_s + side * half_s, start_s) for side in (-1.0, 1.0))
            buffer.add(imu(i * interval_s, (after - before) / (2.0 * half_s)))
        by_blocks = 0.0
        for a, b in pairwise((0.0, 0.25, 0.33, 0.8)):
            block = buffer.cut(at(a), at(b))
            by_blocks += float(block.rate_rad_s[:, 2] @ block.dt_s)
            (leads if b < 0.35 else at_end).append(by_blocks - turned(b, start_s))
    assert abs(np.mean(leads)) < 0.3 * interval_s**2 * acceleration * (0.125 if is_mean else 0.083)
    np.testing.assert_allclose(at_end, 0.0, atol=0.25 * interval_s**2 * acceleration)
    assert abs(np.mean(at_end)) < 1e-6


def test_a_block_that_ends_within_a_dropout_is_as_right() -> None:
    """The lead is that of the usual intervals before, not that of one eight times as long."""
    buffer = MotionBuffer()
    for time_s in (*np.arange(0.0, 0.5, 0.01), *np.arange(0.57, 0.8, 0.01)):
        buffer.add(imu(time_s, 7.0 * max(time_s - 0.2, 0.0)))
    buffer.cut(at(0.0), at(0.45))
    block = buffer.cut(at(0.45), at(0.53))
    assert block.rate_rad_s[:, 2] @ block.dt_s == pytest.approx(3.5 * (0.33**2 - 0.25**2), abs=1e-6)


@pytest.mark.parametrize('block_s', [0.03, 0.1, 0.25])
def test_vibration_is_the_variance_about_the_trend_for_any_blocks(block_s: float) -> None:
    buffer, rng = MotionBuffer(), np.random.default_rng(0)
    for i in range(4001):
        x, y, z = 0.2 * rng.standard_normal(3)
        buffer.add(ImuSample(at(i / 200), (0.0, 0.0, 0.0), (x + i / 200, y - i / 400, z + 9.8)))
    edges = np.arange(0.0, 20.0, block_s)
    found = [buffer.cut(at(a), at(b)).vibration_m2_s4[0] for a, b in pairwise(edges.tolist())]
    assert np.mean(found) == pytest.approx(3 * 0.2**2, rel=0.05)
    assert np.std(found[10:]) < 0.3 * np.mean(found)


def test_vibration_that_begins_is_known_after_two_images() -> None:
    """Late, it would look like an effect of the acceleration with which the robot starts."""
    buffer, rng = MotionBuffer(), np.random.default_rng(0)
    for i in range(400):
        x, y, z = (0.2 if i >= 200 else 0.0) * rng.standard_normal(3)
        buffer.add(ImuSample(at(i / 200), (0.0, 0.0, 0.0), (x, y, z + 9.8)))
    edges = np.arange(0.0, 1.2, 1 / 15)
    found = [buffer.cut(at(a), at(b)).vibration_m2_s4[0] for a, b in pairwise(edges.tolist())]
    assert found[14] < 1e-9 and np.mean(found[-2:]) > 0.7 * 3 * 0.2**2


def test_time_counts_from_the_first_imu_sample() -> None:
    buffer = filled()
    buffer.cut(at(0.0), at(0.5))
    block = buffer.cut(at(0.5), at(0.6))
    np.testing.assert_allclose(block.time_s, np.arange(0.5025, 0.6, 0.005))
    assert buffer.running_s(at(0.6)) == pytest.approx(0.6)


def test_time_continues_from_an_earlier_time_base() -> None:
    buffer = MotionBuffer(running_s=40.0)
    assert buffer.running_s(at(0.0)) == 40.0
    buffer.add(imu(0.0))
    buffer.add(imu(0.1))
    np.testing.assert_allclose(buffer.cut(at(0.0), at(0.1)).time_s, [40.05])


# --- gaps ---------------------------------------------------------------------------------------


def gaps(buffer: MotionBuffer, cuts_s: list[float]) -> list[float]:
    return [buffer.cut(at(start), at(end)).gap_s for start, end in zip(cuts_s[:-1], cuts_s[1:], strict=True)]


def test_a_gap_is_counted_in_the_blocks_that_it_overlaps() -> None:
    buffer = MotionBuffer()
    for time_s in (*np.arange(0.0, 0.3, 0.01), *np.arange(0.55, 0.8, 0.01)):
        buffer.add(imu(float(time_s)))
    assert gaps(buffer, [0.0, 0.2, 0.4, 0.5, 0.7]) == pytest.approx([0.0, 0.11, 0.1, 0.05], abs=1e-9)


def test_a_turn_before_and_after_a_pause_is_none_within() -> None:
    buffer = MotionBuffer()
    for time_s in (0.0, 0.01, 0.02, 26.0, 26.01):
        buffer.add(imu(time_s, 2.0))
    assert np.all(buffer.cut(at(0.0), at(0.02)).rate_rad_s[:, 2] == 2.0)
    block = buffer.cut(at(0.02), at(1.0))
    pause = buffer.cut(at(1.0), at(25.0))
    assert abs(float(block.rate_rad_s[:, 2] @ block.dt_s)) <= 1.0 and not pause.rate_rad_s[:, 2].any()
    assert pause.gap_s == pytest.approx(24.0)


def test_slow_samples_are_not_a_gap() -> None:
    buffer = MotionBuffer()
    for i in range(6):
        buffer.add(imu(i * seconds(GAP_NS)))
    assert gaps(buffer, [0.0, 0.25, 0.5]) == [0.0, 0.0]


def test_a_dropout_counts_less_than_a_gap() -> None:
    buffer = MotionBuffer()
    for i in range(121):
        if not 60 < i < 70:
            buffer.add(imu(i / 200.0))
    dropout_s = 0.05
    assert gaps(buffer, [0.0, 0.25, 0.32, 0.5]) == pytest.approx([0.0, 0.02 * dropout_s, 0.03 * dropout_s])


def test_dropouts_are_counted_while_most_samples_are_lost() -> None:
    rng = np.random.default_rng(0)
    buffer = MotionBuffer()
    times_s = [i / 200.0 for i in range(6001) if i < 200 or rng.random() < 0.2 or i == 6000]
    for time_s in times_s:
        buffer.add(imu(time_s))
    dropouts = [b - a for a, b in pairwise(times_s) if 0.021 < b - a <= seconds(GAP_NS)]
    wide = [b - a for a, b in pairwise(times_s) if b - a > seconds(GAP_NS)]
    gap_s = buffer.cut(at(0.0), at(30.0)).gap_s
    assert gap_s == pytest.approx(sum(wide) + sum(np.square(dropouts)), rel=0.1)
    assert gap_s > 0.3


def test_time_beyond_the_last_sample_is_a_gap() -> None:
    buffer = filled(0.2)
    block = buffer.cut(at(0.1), at(0.5))
    assert block.gap_s == pytest.approx(0.3)
    assert block.wheel_gap_s == pytest.approx(0.3)
    assert not block.wheels_at_rest
    assert buffer.cut(at(0.5), at(0.6)).gap_s == pytest.approx(0.1)


def test_blocks_wait_for_the_wheels_until_a_timeout() -> None:
    buffer = MotionBuffer()
    assert buffer.covered_until_ns() is None
    buffer.add(wheels(0.0))
    assert buffer.covered_until_ns() is None
    buffer.add(imu(0.1))
    assert buffer.covered_until_ns() == at(0.0)
    buffer.add(wheels(0.2))
    assert buffer.covered_until_ns() == at(0.1)
    buffer.add(imu(0.9))
    assert buffer.covered_until_ns() == at(0.9) - WHEEL_TIMEOUT_NS


def test_blocks_do_not_wait_without_wheels() -> None:
    buffer = MotionBuffer()
    buffer.add(imu(0.0))
    buffer.add(imu(0.1))
    assert buffer.covered_until_ns() == at(0.1)


# --- rest ---------------------------------------------------------------------------------------


def rests(buffer: MotionBuffer, cuts_s: list[float]) -> list[bool]:
    blocks = (buffer.cut(at(start), at(end)) for start, end in zip(cuts_s[:-1], cuts_s[1:], strict=True))
    return [block.wheels_at_rest for block in blocks]


@pytest.mark.parametrize('moving', [{'speed': 0.01}, {'speed': -0.01}, {'yaw_rate': 0.01}])
def test_rest_ends_with_the_interval_of_the_first_motion(moving: dict[str, float]) -> None:
    """Check the interval of a reading: that at 0.34 s is the mean since 0.32 s."""
    buffer = MotionBuffer()
    for i in range(101):
        buffer.add(imu(i * 0.01))
    for i in range(51):
        buffer.add(wheels(i * 0.02, **(moving if i == 17 else {})))
    cuts_s = [0.0, 0.1, 0.31, 0.32, 0.33, 0.34, 0.35, 0.5]
    assert rests(buffer, cuts_s) == [True, True, True, False, False, True, True]


def test_no_rest_without_wheels() -> None:
    buffer = MotionBuffer()
    for i in range(101):
        buffer.add(imu(i * 0.01))
    assert rests(buffer, [0.0, 0.5, 1.0]) == [False, False]


def test_no_rest_while_the_wheels_are_unknown() -> None:
    buffer = filled(1.0, wheel_hz=10)
    buffer.add(imu(1.5))
    assert rests(buffer, [0.0, 0.5, 1.0, 1.2]) == [True, True, False]


# --- slow signals, and invalid samples ----------------------------------------------------------


def with_temperature(buffer: MotionBuffer, samples: list[tuple[float, float]]) -> MotionBlock:
    for time_s, value in samples:
        buffer.add(TemperatureSample(at(time_s), value))
        buffer.add(CovariateSample(at(time_s), 'fan.data', 10.0 * value))
    return buffer.cut(at(0.0), at(1.0))


def test_slow_signals_are_linear_between_samples_and_constant_outside() -> None:
    block = with_temperature(filled(), [(0.2, 20.0), (0.7, 30.0)])
    expected = np.interp(block.time_s, [0.2, 0.7], [20.0, 30.0])
    np.testing.assert_allclose(block.temperature_c, expected, atol=1e-6)
    np.testing.assert_allclose(block.covariates['fan.data'], 10.0 * expected, atol=1e-6)


def test_one_sample_is_used_everywhere() -> None:
    block = with_temperature(filled(), [(0.2, 20.0)])
    np.testing.assert_array_equal(block.temperature_c, 20.0)


def test_an_unrecorded_temperature_is_nan() -> None:
    assert np.isnan(filled().cut(at(0.0), at(1.0)).temperature_c).all()


def test_samples_that_are_not_newer_are_ignored() -> None:
    plain, disturbed = filled(speed=0.3), filled(speed=0.3)
    for time_s in (1.0, 0.5, -1.0):
        disturbed.add(imu(time_s, 9.0))
        disturbed.add(wheels(time_s, 9.0))
    expected = with_temperature(plain, [(0.2, 20.0), (0.7, 30.0)])
    block = with_temperature(disturbed, [(0.2, 20.0), (0.2, 80.0), (0.7, 30.0), (0.7, 90.0), (0.1, 99.0)])
    np.testing.assert_array_equal(block.rate_rad_s, expected.rate_rad_s)
    np.testing.assert_array_equal(block.distance_m, expected.distance_m)
    np.testing.assert_array_equal(block.temperature_c, expected.temperature_c)
    np.testing.assert_array_equal(block.covariates['fan.data'], expected.covariates['fan.data'])


def test_memory_stays_bounded() -> None:
    def sizes() -> Iterator[int]:
        buffer = MotionBuffer()
        for second in range(60):
            for i in range(100):
                buffer.add(imu(second + i / 100))
                buffer.add(wheels(second + i / 100, 0.3))
                buffer.add(TemperatureSample(at(second + i / 100), 25.0))
                buffer.add(CovariateSample(at(second + i / 100), 'fan.data', 1.0))
            if second:
                buffer.cut(at(second - 0.5), at(second + 0.5))
                yield len(pickle.dumps(buffer))

    measured = list(sizes())
    assert max(measured[1:]) <= 1.05 * measured[1]
