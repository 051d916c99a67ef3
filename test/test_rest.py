"""Detection of rest, and the noise meanwhile."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import MotionBlock, nanoseconds
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.noise.rest import PRIOR_WINDOWS, RestDetector, RestNoise
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.pipeline.by_heading import for_reference
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

SETTLE_S = 0.5


def block(start_s: float, end_s: float, *, at_rest: bool = True, gap_s: float = 0.0) -> MotionBlock:
    return replace(
        eventful_block(),
        start_ns=nanoseconds(start_s),
        end_ns=nanoseconds(end_s),
        wheels_at_rest=at_rest,
        gap_s=gap_s,
    )


def at_rest(*blocks: MotionBlock) -> list[bool]:
    detector = RestDetector()
    return [detector.is_at_rest(item, SETTLE_S) for item in blocks]


def test_rest_begins_after_the_settling_time() -> None:
    blocks = [block(0.2 * step, 0.2 * (step + 1)) for step in range(5)]
    assert at_rest(*blocks) == [False, False, True, True, True]


def test_one_long_block_is_enough() -> None:
    assert at_rest(block(0.0, 0.6)) == [True]
    assert at_rest(block(0.0, 0.5)) == [False], 'the settling time has to be exceeded'


@pytest.mark.parametrize('interruption', [{'at_rest': False}, {'gap_s': 0.01}], ids=['moved', 'IMU gap'])
def test_motion_or_a_gap_restarts_the_settling_time(interruption: dict[str, float]) -> None:
    interrupted = block(0.6, 0.7, **interruption)  # type: ignore[arg-type]
    found = at_rest(block(0.0, 0.6), interrupted, block(0.7, 1.1), block(1.1, 1.3))
    assert found == [True, False, False, True]


USUAL_RAD_S = math.radians(0.009)


def rest_noise(noise_rad_s: float, step_rad_s: float = 0.0, *, rests: int = 8, seed: int = 0) -> RestNoise:
    """Return the noise after some rests of 3 s, read at 100 Hz, with turns between them."""
    rng, noise = np.random.default_rng(seed), RestNoise(USUAL_RAD_S)
    for number in range(rests):
        for step in range(31):
            readings = 0.1 * number + noise_rad_s * math.sqrt(100.0) * rng.standard_normal(10)
            if step_rad_s > 0.0:
                readings = np.round(readings / step_rad_s) * step_rad_s
            part = replace(block(0.1 * step, 0.1 * (step + 1)), dt_s=np.full(10, 0.01))
            part = replace(part, rate_rad_s=np.stack([readings * 0.0, readings * 0.0, readings], axis=1))
            noise.add(part, is_at_rest=step < 30)
    return noise


@pytest.mark.parametrize('factor', [0.5, 1.0, 2.0, 5.0])
def test_the_noise_at_rest_is_that_of_the_readings(factor: float) -> None:
    found = rest_noise(factor * USUAL_RAD_S).density_rad_s
    assert found == pytest.approx(factor * USUAL_RAD_S, rel=0.25)


def test_a_short_rest_tells_the_noise_as_well_as_independent_means_can() -> None:
    """Ten means of 0.3 s leave nine differences; changes from one mean to the next would count as six."""
    count, tries = 9, range(500)
    squares = np.array([rest_noise(USUAL_RAD_S, rests=1, seed=seed).density_rad_s ** 2 for seed in tries])
    seen = (squares / USUAL_RAD_S**2 * (PRIOR_WINDOWS + count) - PRIOR_WINDOWS) / count
    assert seen.mean() == pytest.approx(1.0, abs=0.07)
    assert seen.var() == pytest.approx(2.0 / count, rel=0.25)


def test_a_change_of_the_bias_between_rests_is_no_noise() -> None:
    assert rest_noise(USUAL_RAD_S, rests=20).density_rad_s < 1.2 * USUAL_RAD_S


def test_readings_that_repeat_do_not_show_the_noise() -> None:
    """A bias may lie anywhere between two steps."""
    assert rest_noise(0.1 * USUAL_RAD_S, math.radians(0.1)).density_rad_s == pytest.approx(USUAL_RAD_S)


@pytest.mark.parametrize('learns', [False, True])
def test_a_first_rest_has_the_noise_of_the_settings(learns: bool) -> None:
    """That of the gyro where it is learned: what the robot sways is not in it beforehand."""
    config = replace(Config(), rest=replace(Config().rest, rate_noise_deg_s=0.02))
    config = for_reference(config) if learns else config
    calm = replace(eventful_block(100), distance_m=np.zeros(100), wheels_at_rest=True)
    gravity = np.tile([0.0, 0.0, 9.8], (100, 1))
    calm = replace(calm, rate_rad_s=np.zeros((100, 3)), specific_force_m_s2=gravity)
    slam = EkfSlam(default_model(), config, replace(SimSource(find_scenario('lanes'), 0).rig, camera=None))
    slam.start_at(calm.start_ns)
    slam.step(calm)
    usual = config.gyro if learns else config.rest
    expected = usual.rate_noise_deg_s / math.sqrt(calm.duration_s)
    found = math.degrees(math.sqrt(slam.state.covariance[YAW_BIAS, YAW_BIAS]))
    assert found == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize('factor', [0.5, 2.0])
def test_the_noise_at_rest_is_split_into_that_of_the_gyro_and_the_sway(factor: float) -> None:
    noise, gyro = RestNoise(factor * USUAL_RAD_S), Config().gyro
    quieter, std = noise.split(gyro, 1e-4, 0.25)
    total_rad2 = math.radians(quieter.rate_noise_deg_s) ** 2 * 0.25 + std[2] ** 2
    assert total_rad2 == pytest.approx((factor * USUAL_RAD_S) ** 2 * 0.25)
    assert quieter.rate_noise_deg_s <= gyro.rate_noise_deg_s and std[0] == std[1] == pytest.approx(5e-5)
