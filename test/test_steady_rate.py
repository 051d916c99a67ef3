"""The rate at which derivatives are taken, and the scale factor before the first turn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contracts import eventful_block

from gyrocal_ros.config.sections import Config, GyroConfig
from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.equations.steady_rate import SteadyRate
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.model.sensor import with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DEG = math.radians(1.0)
GYRO = GyroConfig(rate_noise_deg_s=0.0075)
NO_EFFECTS = sort_effects(())
COUNT, STEP_S = 14, 0.005


def block(yaw_rate_rad_s: np.ndarray) -> MotionBlock:
    rates = np.zeros((COUNT, 3))
    rates[:, 2] = yaw_rate_rad_s
    return replace(eventful_block(COUNT), rate_rad_s=rates, dt_s=np.full(COUNT, STEP_S))


def noisy(rng: np.random.Generator, mean_rad_s: float, factor: float = 1.0) -> MotionBlock:
    noise = factor * 0.0075 * DEG / math.sqrt(STEP_S) * rng.standard_normal(COUNT)
    return block(mean_rad_s + noise)


@pytest.mark.parametrize('factor', [1.0, 10.0])
def test_noise_has_no_part_in_a_steady_rate(factor: float) -> None:
    """Also noise that is larger than the settings say."""
    rng, steady = np.random.default_rng(0), SteadyRate()
    products = []
    for _ in range(500):
        read = noisy(rng, 0.2 * DEG, factor)
        used = steady.without_noise(read, GYRO)
        own = float(read.rate_rad_s[:, 2].mean()) - 0.2 * DEG
        products.append((own * (float(used.rate_rad_s[:, 2].mean()) - 0.2 * DEG), own**2))
    false, all_of_it = np.sum(products, axis=0)
    assert abs(false) < 0.15 * all_of_it
    assert used.rate_rad_s[0, 2] == pytest.approx(0.2 * DEG, abs=0.02 * factor * DEG)


def at_readings(level_rad_s: Array) -> list[MotionBlock]:
    """Return blocks between readings (k COUNT + 1,) of the yaw rate."""
    means, steps = 0.5 * (level_rad_s[1:] + level_rad_s[:-1]), np.diff(level_rad_s)
    return [
        replace(block(mean), yaw_acceleration_rad_s2=step / STEP_S)
        for mean, step in zip(means.reshape(-1, COUNT), steps.reshape(-1, COUNT), strict=True)
    ]


def test_noise_has_no_part_in_a_steady_acceleration() -> None:
    """A lag of the gyro times noise of the acceleration is a rate, which a robot at rest does not have."""
    rng, steady = np.random.default_rng(4), SteadyRate()
    blocks = at_readings(0.0075 * DEG / math.sqrt(STEP_S) * rng.standard_normal(500 * COUNT + 1))
    used = [steady.without_noise(read, GYRO, is_at_rest=True) for read in blocks]
    own, taken = (
        np.array([item.yaw_acceleration_rad_s2.sum() * STEP_S for item in items]) for items in (blocks, used)
    )
    assert abs(own[20:] @ taken[20:]) < 0.01 * (own[20:] @ own[20:])


def test_the_rate_is_the_sum_of_its_acceleration_through_turns() -> None:
    time_s = STEP_S * np.arange(200 * COUNT + 1)
    turn = 90.0 * DEG * np.clip(2.0 * np.sin(0.5 * time_s), -1.0, 1.0)
    turn[time_s < 2.0] = 0.0
    rng = np.random.default_rng(5)
    noise = 0.0075 * DEG / math.sqrt(STEP_S) * rng.standard_normal(len(time_s))
    steady, reached = SteadyRate(), 0.0
    for number, read in enumerate(at_readings(turn + noise), start=1):
        used = steady.without_noise(read, GYRO)
        reached += float(used.yaw_acceleration_rad_s2.sum()) * STEP_S
        lately = turn[max(number - 3, 0) * COUNT : number * COUNT + 1]
        if np.ptp(lately) == 0.0:
            assert reached == pytest.approx(lately[-1] - noise[0], abs=0.3 * DEG)


def test_vibration_at_rest_has_no_part_either() -> None:
    """The blocks of a running motor differ by more than noise; no block of a robot at rest is a turn."""
    rng, steady = np.random.default_rng(2), SteadyRate()
    blocks = [noisy(rng, 0.1 * DEG + 0.6 * DEG * math.sin(0.4 * k)) for k in range(200)]
    used = [steady.without_noise(read, GYRO, is_at_rest=True) for read in blocks]
    late = [float(item.rate_rad_s[:, 2].mean()) for item in used[100:]]
    assert late == pytest.approx([0.1 * DEG] * 100, abs=0.06 * DEG)
    by_hand = noisy(rng, 5.0 * DEG)
    used_by_hand = steady.without_noise(by_hand, GYRO, is_at_rest=True)
    np.testing.assert_array_equal(used_by_hand.rate_rad_s, by_hand.rate_rad_s)


def test_the_estimate_of_the_vibration_has_no_part_in_derivatives() -> None:
    """It errs by a quarter where it is that of few samples, which would halve the estimate of an effect."""
    rng, steady = np.random.default_rng(3), SteadyRate()
    true = np.repeat([0.05, 0.15], 200)
    read = true * (1.0 + 0.25 * rng.standard_normal(400))
    blocks = [replace(block(np.zeros(COUNT)), vibration_m2_s4=np.full(COUNT, value)) for value in read]
    used = np.array([steady.without_noise(item, GYRO).vibration_m2_s4[0] for item in blocks])
    own, taken = read - true, used - true
    after = (np.arange(400) % 200) > 10
    assert abs(np.mean(own[after] * taken[after])) < 0.1 * np.mean(own[after] ** 2)
    np.testing.assert_allclose(used[after], true[after], rtol=0.5)


def test_a_turn_is_taken_as_it_is_read() -> None:
    rng, steady = np.random.default_rng(1), SteadyRate()
    for _ in range(20):
        steady.without_noise(noisy(rng, 0.0), GYRO)
    for rate in np.linspace(1.0, 60.0, 20) * DEG:
        read = noisy(rng, float(rate))
        used = steady.without_noise(read, GYRO)
        np.testing.assert_array_equal(used.rate_rad_s, read.rate_rad_s)


def test_the_change_of_the_rate_is_known_where_it_is_not_steady() -> None:
    rng, steady = np.random.default_rng(1), SteadyRate()
    for rate, change in [(0.0, 0.0)] * 10 + [(40.0, 40.0)] + [(40.0, 0.0)] * 10 + [(-10.0, -50.0)]:
        steady.without_noise(noisy(rng, rate * DEG), GYRO)
        assert steady.change_rad_s == pytest.approx(change * DEG, abs=0.5 * DEG)
        assert (steady.change_rad_s == 0.0) == (change == 0.0)


def test_a_slow_change_is_followed() -> None:
    rng, steady = np.random.default_rng(2), SteadyRate()
    for rate in np.linspace(0.0, 2.0, 600) * DEG:
        used = steady.without_noise(noisy(rng, float(rate)), GYRO)
    assert used.rate_rad_s[:, 2].mean() == pytest.approx(2.0 * DEG, abs=0.12 * DEG)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 11, 19])
def test_before_the_first_turn_the_scale_factor_is_not_drawn_away(seed: int) -> None:
    """Driving straight says nothing of the scale factor, however well the camera sees the heading."""
    scenario = find_scenario('cleaning')
    source = SimSource(
        replace(scenario, duration_s=27.0, errors=replace(scenario.errors, pixel_noise_px=0.05)), seed
    )
    config = Config()
    config = replace(config, camera=replace(config.camera, pixel_noise_px=0.05))
    history = calibrate(source, config, default_model()).history
    straight = np.cumsum(np.abs(history.turn_rad)) < 4.0 * DEG
    assert history.time_s[straight][-1] > 10.0
    scale, std = (column[straight, COEFFICIENTS_START] for column in (history.mean, history.std))
    assert np.abs((1.0 + scale - source.truth.scale_factor) / std).max() < 2.5


@pytest.mark.parametrize('factor', [0.5, 1.0, 1.5, 5.0, 20.0])
def test_the_noise_of_the_readings_replaces_a_setting_that_is_far_too_small(factor: float) -> None:
    """While the robot accelerates, too: 500 deg/s^2. The rate of an interval is the mean of two readings."""
    rng, steady, used = np.random.default_rng(1), SteadyRate(), GYRO
    speeding_up = 500.0 * DEG * STEP_S * np.arange(COUNT)
    for _ in range(200):
        readings = factor * 0.0075 * DEG / math.sqrt(STEP_S) * rng.standard_normal(COUNT + 1)
        used = steady.with_noise(block(speeding_up + 0.5 * (readings[1:] + readings[:-1])), GYRO, NO_EFFECTS)
    if factor < 2.0:
        assert used is GYRO
    else:
        assert used.rate_noise_deg_s == pytest.approx(factor * 0.0075, rel=0.15)


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_each_axis_has_the_noise_of_its_own_readings(axis: int) -> None:
    rng, steady, used = np.random.default_rng(4), SteadyRate(), GYRO
    factors = np.ones(3)
    factors[axis] = 10.0
    for _ in range(200):
        readings = factors * 0.0075 * DEG / math.sqrt(STEP_S) * rng.standard_normal((COUNT + 1, 3))
        rates = 0.5 * (readings[1:] + readings[:-1])
        used = steady.with_noise(replace(block(np.zeros(COUNT)), rate_rad_s=rates), GYRO, NO_EFFECTS)
    assert steady.tilt_noise_rad_s is not None
    noise = np.append(steady.tilt_noise_rad_s, used.rate_noise_deg_s * DEG)
    np.testing.assert_allclose(noise, factors * 0.0075 * DEG, rtol=0.15)


def test_noise_that_an_effect_explains_is_not_taken_over_as_well() -> None:
    rng, steady, used = np.random.default_rng(5), SteadyRate(), GYRO
    known = with_means(find_effect('gyro_noise'), (0.07 * DEG,))
    for _ in range(200):
        readings = 0.075 * DEG / math.sqrt(STEP_S) * rng.standard_normal(COUNT + 1)
        read = block(0.5 * (readings[1:] + readings[:-1]))
        used = steady.with_noise(read, GYRO, sort_effects((known,)))
    assert used is GYRO
    too_small = with_means(find_effect('gyro_noise'), (0.02 * DEG,))
    rest = steady.with_noise(read, GYRO, sort_effects((too_small,)))
    assert math.hypot(rest.rate_noise_deg_s, 0.02) == pytest.approx(0.075, rel=0.15)


def test_samples_out_of_place_are_noise_while_the_rate_changes() -> None:
    """Wrong stamps put the samples of a turn that begins in a wrong order; a steady rate hides that."""
    rng, steady = np.random.default_rng(3), SteadyRate()
    for _ in range(100):
        steady.with_noise(noisy(rng, 0.0, factor=0.3), GYRO, NO_EFFECTS)
    in_order = block(300.0 * DEG * STEP_S * np.arange(COUNT))
    wrong_order = block(300.0 * DEG * STEP_S * rng.permutation(COUNT))
    irregular_s = STEP_S * rng.exponential(size=COUNT)
    assert steady.with_noise(in_order, GYRO, NO_EFFECTS) is GYRO
    assert steady.with_noise(wrong_order, GYRO, NO_EFFECTS) is GYRO
    assert steady.with_noise(replace(in_order, dt_s=irregular_s), GYRO, NO_EFFECTS) is GYRO
    used = steady.with_noise(replace(wrong_order, dt_s=irregular_s), GYRO, NO_EFFECTS)
    assert used.rate_noise_deg_s > 20.0 * GYRO.rate_noise_deg_s
