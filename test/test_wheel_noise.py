"""The noise of the wheels is learned from images that tell the way better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.config.sections import Config, WheelConfig
from gyrocal_ros.data import Array
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.noise.wheel_noise import PositionScore, WheelNoise
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

SETTINGS = WheelConfig(distance_noise_m=0.005, lateral_noise_m=0.004, turn_noise_m=0.002)
WAY_M, INTERVAL_S = 0.02, 0.1
YAW_RAD = 0.7
IMAGE_NOISE_M = 2e-4
"""Standard deviation of the way by an image."""
IMAGES = 1500

Errors = Callable[[np.random.Generator], Array]
"""Draws errors (IMAGES, 2) along the way and across it, in units of those of the settings."""


def white(along: float, across: float) -> Errors:
    return lambda rng: rng.standard_normal((IMAGES, 2)) * [along, across]


def learned(errors: Errors, turn_rad: float = 0.0, images: int = IMAGES) -> WheelNoise:
    """Learn from drives in a straight line, or on a bend, of which images measure the position directly."""
    rng, noise = np.random.default_rng(3), WheelNoise(SETTINGS)
    block = eventful_block()
    count, rates = len(block.dt_s), np.zeros((len(block.dt_s), 3))
    rates[:, 2] = turn_rad / INTERVAL_S
    block = replace(
        block,
        dt_s=np.full(count, INTERVAL_S / count),
        distance_m=np.full(count, WAY_M / count),
        rate_rad_s=rates,
        start_ns=0,
        end_ns=round(INTERVAL_S * 1e9),
    )
    axes = np.array([[np.cos(YAW_RAD), -np.sin(YAW_RAD)], [np.sin(YAW_RAD), np.cos(YAW_RAD)]])
    for error in errors(rng)[:images]:
        noise.move(block)
        of_settings, now = (
            np.array(
                [wheels.distance_noise_m**2 * WAY_M + wheels.turn_noise_m**2 * turn_rad]
                + [wheels.lateral_noise_m**2 * WAY_M]
            )
            for wheels in (SETTINGS, noise.config)
        )
        seen = np.sqrt(of_settings) * error + IMAGE_NOISE_M * rng.standard_normal(2)
        precisions = 1.0 / (now + IMAGE_NOISE_M**2)
        told = PositionScore(axes @ (precisions * seen), axes * precisions @ axes.T)
        noise.learn(told, YAW_RAD)
    return noise


def factors(noise: WheelNoise) -> tuple[float, float, float]:
    """Return the noise along the way, across it and by turns, relative to the settings."""
    found = noise.config
    return (
        found.distance_noise_m / SETTINGS.distance_noise_m,
        found.lateral_noise_m / SETTINGS.lateral_noise_m,
        found.turn_noise_m / SETTINGS.turn_noise_m,
    )


@pytest.mark.parametrize(('along', 'across'), [(3.0, 1.0), (1.0, 2.0), (6.0, 4.0)])
@pytest.mark.parametrize('turn_rad', [0.0, 0.1])
def test_noise_is_learned_by_its_direction(along: float, across: float, turn_rad: float) -> None:
    found = factors(learned(white(along, across), turn_rad))
    assert found == pytest.approx((along, across, along), rel=0.15)


def test_noise_is_never_below_the_settings() -> None:
    assert factors(learned(white(0.2, 0.0))) == (1.0, 1.0, 1.0)


def test_ten_seconds_tell_that_wheels_are_noisy() -> None:
    assert factors(learned(white(4.0, 1.0), images=100))[0] > 2.5


def test_errors_that_are_alike_in_several_images_count_together() -> None:
    """Encoders at 2 Hz: the sum over their interval errs as much as if each image had erred alone."""

    def held(rng: np.random.Generator) -> Array:
        return np.repeat(rng.standard_normal((IMAGES // 5, 2)) * [3.0, 1.0], 5, axis=0) / np.sqrt(5.0)

    assert factors(learned(held))[0] == pytest.approx(3.0, rel=0.2)


def test_an_error_that_stays_is_no_noise() -> None:
    """A map that is 10 % too large makes every way too long by 2 mm, 3 standard deviations."""
    assert factors(learned(lambda rng: white(1.0, 1.0)(rng) + [3.0, 0.0]))[0] < 1.2


def test_a_few_large_errors_are_no_noise() -> None:
    """Once in 15 seconds the robot is pushed."""

    def pushed(rng: np.random.Generator) -> Array:
        drawn = white(1.0, 1.0)(rng)
        drawn[::150] += 100.0
        return drawn

    assert factors(learned(pushed))[0] < 1.5


def test_images_that_tell_nothing_change_nothing() -> None:
    noise = learned(white(1.0, 1.0), images=20)
    before = noise.config
    for _ in range(20):
        noise.move(eventful_block())
        noise.learn(None, YAW_RAD)
    assert noise.config is before


def filter_on(wheel_noise_m: float, wheel_hz: int, seed: int) -> EkfSlam:
    """Run the filter on a robot whose wheels are as noisy as that."""
    usual = find_scenario('cleaning')
    errors = replace(usual.errors, wheel_noise_m=wheel_noise_m)
    scenario = replace(usual, duration_s=50.0, imu_hz=100, wheel_hz=wheel_hz, camera_hz=10, errors=errors)
    source = SimSource(scenario, seed)
    slam = EkfSlam(default_model(), Config(), source.rig)
    stream = SlamStream(slam)
    for measurement in source.measurements():
        stream.step(measurement)
    return slam


@pytest.mark.slow
@pytest.mark.parametrize('wheel_hz', [50, 5])
def test_a_drive_tells_the_noise_of_its_wheels(wheel_hz: int) -> None:
    slam = filter_on(0.0125, wheel_hz, seed=2)
    assert slam.wheel_noise.config.distance_noise_m == pytest.approx(0.0125, rel=0.25)
    assert slam.wheel_noise.config.lateral_noise_m < 0.006
    quiet = filter_on(0.004, wheel_hz, seed=2)
    assert quiet.wheel_noise.config.distance_noise_m < 0.006
