"""The noise of the yaw gyro at rest, from all rests of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, ClockStep, ImuSample, Measurement, Source, WheelSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.rests import RestFinder
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

USUAL_DEG_S = Config().gyro.rate_noise_deg_s
IMU_HZ, WHEEL_HZ, PERIOD_S, REST_S, DURATION_S = 100, 50, 10.0, 4.0, 60.0


def recorded(factor: float) -> list[Measurement]:
    """Return a recording of a robot that rests 4 s of ten, with that many times the usual noise at rest."""
    rng = np.random.default_rng(3)
    noise_rad_s = factor * math.radians(USUAL_DEG_S) * math.sqrt(IMU_HZ)
    samples: list[Measurement] = []
    for index in range(round(DURATION_S * IMU_HZ)):
        time_s = index / IMU_HZ
        turns = time_s % PERIOD_S >= REST_S
        rate = 0.8 if turns else 0.01 + noise_rad_s * float(rng.standard_normal())
        stamp_ns = round(time_s * NS_PER_S)
        samples.append(ImuSample(stamp_ns, (0.0, 0.0, rate), (0.0, 0.0, 9.8)))
        if index % (IMU_HZ // WHEEL_HZ) == 0:
            samples.append(WheelSample(stamp_ns, 0.2 * turns, 0.8 * turns))
    return samples


def found_deg_s(samples: Sequence[Measurement]) -> float:
    finder = RestFinder(Config())
    for item in samples:
        finder.add(item)
    return math.degrees(finder.noise_rad_s)


@pytest.mark.parametrize('factor', [0.5, 1.0, 3.0])
def test_it_is_that_of_the_readings_at_rest(factor: float) -> None:
    assert found_deg_s(recorded(factor)) == pytest.approx(factor * USUAL_DEG_S, rel=0.2)


def test_without_wheels_it_is_that_of_the_gyro() -> None:
    samples = [item for item in recorded(3.0) if not isinstance(item, WheelSample)]
    assert found_deg_s(samples) == pytest.approx(USUAL_DEG_S)


def test_it_is_found_on_both_sides_of_a_step_of_the_clock() -> None:
    samples = recorded(3.0)
    half = len(samples) // 2
    step = ClockStep(samples[half].t_ns - 50 * NS_PER_S, -50 * NS_PER_S)
    later = [replace(item, t_ns=item.t_ns - 50 * NS_PER_S) for item in samples[half:]]  # type: ignore[type-var]
    assert found_deg_s([*samples[:half], step, *later]) == pytest.approx(3.0 * USUAL_DEG_S, rel=0.2)


class Swaying(ReferenceSource):
    """A robot that sways at rest, by a white noise of its yaw rate."""

    def measurements(self) -> Iterator[Measurement]:
        rng, sway_rad_s = np.random.default_rng(self.robot.seed), math.radians(SWAY_DEG_S)
        start_ns, scale = self.span.start_ns, math.sqrt(self.robot.scenario.imu_hz)
        for item in super().measurements():
            if isinstance(item, ImuSample) and item.t_ns - start_ns < SWAYS_S * NS_PER_S:
                x, y, z = item.rate_rad_s
                item = replace(item, rate_rad_s=(x, y, z + sway_rad_s * scale * float(rng.standard_normal())))
            yield item


SWAY_DEG_S, SWAYS_S, ROBOTS = 0.03, 3.0, range(5)


def test_a_robot_that_sways_at_its_first_rest_knows_its_bias_the_less() -> None:
    """The beginning of that rest was once used with the noise of the gyro alone."""

    def bias_std(source: Source) -> float:
        return float(conclude(calibrate(source, Config(), default_model())).stds[0])

    drive = replace(find_scenario('cleaning'), duration_s=40.0, imu_hz=100, camera_hz=5)
    stds = [
        [bias_std(kind(SimSource(drive, seed), 'lidar')) for kind in (ReferenceSource, Swaying)]
        for seed in ROBOTS
    ]
    calm, swaying = np.median(stds, axis=0)
    assert swaying > 2.5 * calm
