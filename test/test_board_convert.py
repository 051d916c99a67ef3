"""Conversion of the board's counts to samples in SI units and to the motion of the robot."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from gyrocal_ros.board.clock import Clock, Stamp
from gyrocal_ros.board.convert import (
    MAX_INTERVAL_S,
    SupplySample,
    WheelReading,
    imu_sample,
    supply_sample,
    temperature_sample,
    wheel_sample,
)
from gyrocal_ros.board.messages import Imu, Supply, Wheels
from gyrocal_ros.board.protocol import Decoder, encode
from gyrocal_ros.config.robot_sections import BoardConfig
from gyrocal_ros.data import NS_PER_S, STANDARD_GRAVITY_M_S2, TemperatureSample

T_NS = 1_700_000_000_000_000_000
LEVEL = Imu((0, 0, 0), (0, 0, 8192), 0)
MAX_TICKS = 2**31 - 1


PAGE = Path(__file__).resolve().parent.parent / 'docs/board_protocol.md'


def reading(time_us: int, left: int, right: int, base: int = 0) -> WheelReading:
    return WheelReading(Stamp(T_NS + time_us * 1000, base), time_us, Wheels(left, right))


def test_a_gyro_volt_is_converted_by_the_data_sheet() -> None:
    volt = Imu((0, 0, 100_000), (0, 0, 0), 0)
    assert imu_sample(volt, T_NS, BoardConfig()).rate_rad_s == pytest.approx((0.0, 0.0, math.radians(146.4)))


def test_nominal_bias_and_scale_of_each_axis_are_applied() -> None:
    config = replace(
        BoardConfig(), gyro_zero=(10.0, 20.0, 30.0), gyro_scale_factor_volt=(500.0, -500.0, 146.4)
    )
    sample = imu_sample(Imu((1010, 1020, 30), (0, 0, 0), 0), T_NS, config)
    assert sample.rate_rad_s == pytest.approx((math.radians(5.0), math.radians(-5.0), 0.0))


def test_a_level_board_measures_gravity() -> None:
    sample = imu_sample(LEVEL, T_NS, BoardConfig())
    assert sample.t_ns == T_NS
    assert sample.specific_force_m_s2 == pytest.approx((0.0, 0.0, STANDARD_GRAVITY_M_S2))
    shifted = replace(BoardConfig(), accelerometer_zero=(0.0, 0.0, 8192.0))
    assert imu_sample(LEVEL, T_NS, shifted).specific_force_m_s2 == (0.0, 0.0, 0.0)


def test_temperature_has_a_scale_and_an_offset() -> None:
    warm = replace(LEVEL, temperature=2550)
    assert temperature_sample(warm, T_NS, BoardConfig()) == TemperatureSample(T_NS, 25.5)
    chip = replace(BoardConfig(), temperature_scale=1 / 256, temperature_zero_c=21.0)
    assert temperature_sample(replace(LEVEL, temperature=512), T_NS, chip).temperature_c == 23.0


def test_the_supply_is_converted_to_volts_and_amperes() -> None:
    assert supply_sample(Supply(16_400, -1250), T_NS) == SupplySample(T_NS, 16.4, -1.25)


@pytest.mark.parametrize('start', [0, MAX_TICKS, -5])
@pytest.mark.parametrize('start_us', [0, (1 << 32) - 5000])
def test_ticks_are_converted_to_speed_and_yaw_rate_over_all_wraps(start: int, start_us: int) -> None:
    def wrapped(ticks: int) -> int:
        return (ticks + 2**31) % 2**32 - 2**31

    config = replace(BoardConfig(), tick_m=0.001, track_m=0.2)
    before = reading(start_us, wrapped(start), wrapped(-start))
    after = reading((start_us + 20_000) % (1 << 32), wrapped(start + 4), wrapped(-start + 8))
    sample = wheel_sample(before, after, config)
    assert sample is not None
    assert (sample.speed_m_s, sample.yaw_rate_rad_s) == pytest.approx((0.3, 1.0))
    assert sample.t_ns == after.stamp.t_ns


@pytest.mark.parametrize(
    'after',
    [
        reading(20_000, 5, 5, base=1),
        reading(0, 5, 5),
        reading(round(MAX_INTERVAL_S * 1e6) + 1, 5, 5),
    ],
    ids=['restart', 'no time', 'long gap'],
)
def test_readings_that_are_not_consecutive_give_no_motion(after: WheelReading) -> None:
    assert wheel_sample(reading(0, 0, 0), after, BoardConfig()) is None


def test_the_distance_is_preserved_when_a_frame_is_lost() -> None:
    frames = [encode(Wheels(100 * i, 100 * i), i, 20_000 * i) for i in range(6)]
    del frames[2]
    decoder, clock, config = Decoder(), Clock(), BoardConfig()
    readings = []
    for packet in decoder.feed(b''.join(frames)):
        stamp = clock.stamp(packet.time_us, T_NS + packet.time_us * 1000)
        assert stamp is not None and isinstance(packet.message, Wheels)
        readings.append(WheelReading(stamp, packet.time_us, packet.message))
    pairs = list(zip(readings, readings[1:], strict=False))
    samples = [wheel_sample(before, after, config) for before, after in pairs]
    distance_m = sum(
        sample.speed_m_s * (after.stamp.t_ns - before.stamp.t_ns) / NS_PER_S
        for sample, (before, after) in zip(samples, pairs, strict=True)
        if sample
    )
    assert decoder.counts.lost == 1
    assert distance_m == pytest.approx(500 * config.tick_m)


def test_the_protocol_page_has_the_nominal_counts() -> None:
    config = BoardConfig()
    [gyro_scale] = set(config.gyro_scale_factor_volt)
    [force_scale] = set(config.accelerometer_scale)
    assert force_scale == 4.0 * STANDARD_GRAVITY_M_S2 / 32768
    assert (
        f'Nominally a gyro count is {config.gyro_volt * 1e6:g} µV at {gyro_scale} deg/s/V, '
        f'an accelerometer count 4 g / 32768 and a temperature count {config.temperature_scale} deg C'
    ) in ' '.join(PAGE.read_text(encoding='utf-8').split())
