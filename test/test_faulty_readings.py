"""Faulty readings of gyro and encoders are left out or replaced; everything that motion explains passes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from recordings import ModifiedSource, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array, ImuSample, Measurement, WheelSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.model.faulty_readings import FROZEN, SPIKE, FaultyGyro, FaultyWheels
from gyrocal_ros.pipeline.calibrate import calibrate

NOISE_RAD_S = 0.002
PERIOD_NS = 10_000_000
DEG = math.radians(1.0)


def turning(seconds: float = 8.0) -> Array:
    """Return rates (n, 3) of a gyro with noise: at rest for 3 s, then turns of 40 deg/s to either side."""
    time_s = np.arange(round(100 * seconds)) / 100.0
    rates = np.random.default_rng(1).normal(0.0, NOISE_RAD_S, (len(time_s), 3))
    rates[:, 2] += 40.0 * DEG * np.clip(np.sin(2.0 * (time_s - 3.0)) * 3.0, -1.0, 1.0) * (time_s > 3.0)
    return rates


def samples(rates: Array) -> list[ImuSample]:
    return [
        ImuSample(i * PERIOD_NS, (float(x), float(y), float(z)), (0.0, 0.0, 9.8))
        for i, (x, y, z) in enumerate(rates)
    ]


def passed(rates: Array) -> tuple[FaultyGyro, list[int]]:
    """Return the judge, and the numbers of the readings that it has passed, in their order."""
    faulty = FaultyGyro()
    sound = [out.t_ns // PERIOD_NS for sample in samples(rates) for out in faulty.sound([sample])]
    return faulty, sound


def test_all_readings_of_a_sound_gyro_pass_at_once() -> None:
    faulty = FaultyGyro()
    for sample in samples(turning()):
        assert faulty.sound([sample]) == [sample]
    assert faulty.news() == ''


@pytest.mark.parametrize('size_rad_s, count', [(0.5, 1), (-4.0, 1), (30.0, 1), (-8.0, 2), (30.0, 2)])
def test_spikes_are_left_out(size_rad_s: float, count: int) -> None:
    rates = turning()
    rates[420 : 420 + count, 2] += size_rad_s
    faulty, sound = passed(rates)
    assert sound == [i for i in range(len(rates)) if not 420 <= i < 420 + count]
    assert faulty.spikes == count and faulty.news() == SPIKE
    assert faulty.news() == ''


@pytest.mark.parametrize('size_rad_s, count', [(2.0, 2), (30.0, 3)])
def test_a_blow_that_turns_the_robot_passes(size_rad_s: float, count: int) -> None:
    rates = turning()
    rates[420 : 420 + count, 2] += size_rad_s
    faulty, sound = passed(rates)
    assert sound == list(range(len(rates))) and not faulty.spikes


def test_vibration_passes() -> None:
    rates = turning()
    rates[:, 2] += 0.5 * np.random.default_rng(2).standard_normal(len(rates))
    faulty, sound = passed(rates)
    assert not faulty.spikes and sound == list(range(len(sound)))


def test_readings_that_repeat_are_left_out() -> None:
    rates = turning()
    rates[421:460] = rates[420]
    rates[250:330] = rates[249]  # from rest into the turn
    faulty, sound = passed(rates)
    assert sound == [i for i in range(len(rates)) if not 250 <= i < 330 and not 421 <= i < 460]
    assert faulty.frozen == 39 + 80 and faulty.news() == FROZEN


def test_zeros_within_a_turn_are_left_out() -> None:
    rates = turning()
    rates[421:460] = 0.0
    faulty, sound = passed(rates)
    assert sound == [i for i in range(len(rates)) if not 421 <= i < 460]
    assert faulty.frozen == 39


def test_few_repeated_readings_pass() -> None:
    rates = turning()
    rates[421:425] = rates[420]
    faulty, sound = passed(rates)
    assert sound == list(range(len(rates))) and not faulty.frozen


def test_the_limit_of_a_range_is_no_frozen_reading() -> None:
    rates = turning()
    rates[:, :2] = 0.0  # two axes without noise, as some simulators have
    rates[:, 2] = np.clip(rates[:, 2], -30.0 * DEG, 30.0 * DEG)
    faulty, sound = passed(rates)
    assert sound == list(range(len(rates))) and not faulty.frozen


def test_a_coarse_gyro_may_repeat_itself() -> None:
    faulty, sound = passed(np.round(turning() / DEG) * DEG)
    assert sound == list(range(len(sound))) and not faulty.frozen


def test_a_reading_that_is_not_newer_is_ignored() -> None:
    faulty, (first, second, *_) = FaultyGyro(), samples(turning())
    assert faulty.sound([second]) == [second]
    assert faulty.sound([first, second]) == []


def speeds(values_m_s: list[float]) -> tuple[FaultyWheels, list[float]]:
    """Return the judge, and the speeds that it has passed, of readings every 50 ms."""
    faulty = FaultyWheels()
    sound: list[WheelSample] = []
    for i, speed_m_s in enumerate(values_m_s):
        sound += faulty.sound([WheelSample(5 * i * PERIOD_NS, speed_m_s, 0.1)])
    return faulty, [sample.speed_m_s for sample in sound]


@pytest.mark.parametrize('glitch_m_s', [(9.0,), (-3.0,), (6.0, -6.0)])
def test_spikes_of_the_encoders_are_replaced(glitch_m_s: tuple[float, ...]) -> None:
    faulty, sound = speeds([0.1, 0.2, *glitch_m_s, 0.4, 0.3])
    assert sound == pytest.approx([0.1, 0.2, *[0.3] * len(glitch_m_s), 0.4, 0.3])
    assert faulty.spikes == len(glitch_m_s)


def test_speeds_that_wheels_reach_pass() -> None:
    values_m_s = [
        0.0,
        0.3,
        1.2,
        0.2,
        -0.8,
        0.0,
        5.0,
        5.0,
        5.1,
        5.0,
        0.0,
        0.0,
        0.0,
    ]  # slips, and a sudden unit
    faulty, sound = speeds(values_m_s)
    assert sound == values_m_s and not faulty.spikes


def with_faults(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    """Yield a recording whose gyro has a spike a second, and repeats itself for 0.3 s every 7 s."""
    kept, count = (0.0, 0.0, 0.0), 0
    for item in measurements:
        if isinstance(item, ImuSample):
            count += 1
            if count > 500 and count % 700 < 30:
                item = replace(item, rate_rad_s=kept)
            elif count % 100 == 50:
                x, y, z = item.rate_rad_s
                item = replace(item, rate_rad_s=(x, y, z + 4.0))
            else:
                kept = item.rate_rad_s
        yield item


def test_a_calibration_survives_faulty_readings() -> None:
    source = recording('cleaning', 3, duration_s=60.0)
    run = calibrate(ModifiedSource(source, with_faults), Config(), default_model())
    error = 1.0 + run.state.coefficients[0] - source.truth.scale_factor
    assert abs(error) < 3.0 * run.history.std[-1, -1] < 0.003
    events = ' '.join(event.text for event in run.events)
    assert events.count(SPIKE) == 1 and events.count(FROZEN) == 1
