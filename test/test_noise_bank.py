"""Alternatives of the noise of the gyro: standard deviations that are right where the settings are not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import changed
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.noise.noise_bank import WALK, WHITE, NoiseBank
from gyrocal_ros.ekf.state.layout import SCALE, YAW_BIAS, State
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import with_bias_walk
from gyrocal_ros.sim.world import SimSource

WALK_RAD_S, WHITE_RAD_S = 4e-6, 1e-4
"""Random walk in a second and noise of the mean rate of a second that the filter expects."""
STEPS = 300
"""Of a second each."""


def initial() -> State:
    return initial_state(default_model(), Config(), None)


def with_bias(state: State, mean: float, variance: float) -> State:
    means, covariance = state.mean.copy(), state.covariance.copy()
    means[YAW_BIAS], covariance[YAW_BIAS, YAW_BIAS] = mean, variance
    return changed(state, mean=means, covariance=covariance)


def filtered(walk: float, white: float, seed: int) -> Iterator[tuple[State, State, float]]:
    """Yield the states predicted and after each step of a filter of the bias, and the true bias.

    Args:
        walk: factor on the true random walk, relative to the expected one.
        white: the same on the white noise.
        seed: of the noise.
    """
    rng, state, bias = np.random.default_rng(seed), initial(), 0.0
    for _ in range(STEPS):
        bias += walk * WALK_RAD_S * rng.normal()
        measured = bias + white * WHITE_RAD_S * rng.normal()
        mean = state.mean[YAW_BIAS]
        variance = state.covariance[YAW_BIAS, YAW_BIAS] + WALK_RAD_S**2
        predicted = with_bias(state, mean, variance)
        gain = variance / (variance + WHITE_RAD_S**2)
        state = with_bias(state, mean + gain * (measured - mean), (1.0 - gain) * variance)
        yield predicted, state, bias


def errors(walk: float, white: float) -> np.ndarray:
    """Return the errors (40, 2) of the bias at the end, in sigmas by the filter and by filter and bank."""
    found = []
    for seed in range(40):
        bank = NoiseBank(initial())
        steps = [*filtered(walk, white, seed)]
        for predicted, state, _ in steps:
            bank.add(predicted, state, 1.0)
        state, bias = steps[-1][1:]
        error, std = state.mean[YAW_BIAS] - bias, math.sqrt(state.covariance[YAW_BIAS, YAW_BIAS])
        found.append((error / std, error / math.hypot(std, bank.unexpected_std(state)[0])))
    return np.array(found)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0))


def test_noise_as_expected_costs_little() -> None:
    by_filter, with_bank = rms(errors(1.0, 1.0))
    assert 0.8 * by_filter < with_bank < by_filter


@pytest.mark.parametrize(('walk', 'white'), [(4.0, 1.0), (1.0, 2.0), (2.0, 2.0)])
def test_larger_noise_is_covered(walk: float, white: float) -> None:
    by_filter, with_bank = rms(errors(walk, white))
    assert by_filter > 1.5
    assert 0.85 < with_bank < 1.3


def test_the_likeliest_alternative_is_the_true_noise() -> None:
    weights = np.zeros(len(WHITE) * len(WALK))
    for seed in range(20):
        bank = NoiseBank(initial())
        for predicted, state, _ in filtered(4.0, 1.0, seed):
            bank.add(predicted, state, 1.0)
        weights += bank.weights / 20
    by_walk, by_white = weights.reshape(len(WALK), len(WHITE)).sum(axis=1), weights.reshape(-1, len(WHITE))
    assert WALK[int(np.argmax(by_walk))] == 16.0
    assert WHITE[int(np.argmax(by_white.sum(axis=0)))] == 1.0


@pytest.mark.parametrize(('walk', 'least'), [(1.0, 1.0), (8.0, 2.0)])
def test_a_walk_is_told_where_it_is_certain(walk: float, least: float) -> None:
    told = []
    for seed in range(10):
        bank = NoiseBank(initial())
        for predicted, state, _ in filtered(walk, 1.0, seed):
            bank.add(predicted, state, 1.0)
        told.append(bank.least_walk)
    assert np.median(told) >= least
    assert max(told) <= walk


@pytest.mark.slow
@pytest.mark.parametrize('follows', [True, False])
def test_a_robot_reports_that_its_bias_walks_more_than_set(follows: bool) -> None:
    """Once for each factor, and it follows the bias where models are not compared."""
    scenario, set_walk = replace(find_scenario('cleaning'), duration_s=120.0), Config().gyro.bias_walk_deg_s
    errors = with_bias_walk(scenario.errors, 16.0 * set_walk, bounded_s=1e5)
    simulated = SimSource(replace(scenario, errors=errors), seed=1)
    run = calibrate(simulated, Config(), default_model(), follows_changes=follows)
    events = [event.text for event in run.events if 'bias_walk_deg_s' in event.text]
    assert events
    assert len(events) == len(set(events))
    found, walks = conclude(run), run.history.bias_walk
    assert walks[0] == 1 and (walks[-1] >= 4 if follows else walks.max() == 1)
    assert abs(found.scale_factor - simulated.truth.scale_factor) < 3.0 * found.scale_factor_std
    if follows:
        assert found.scale_factor_std < 2e-4
    else:
        assert found.stds[0] > 1.5 * run.history.std[-1, YAW_BIAS]


def test_a_coefficient_that_is_not_measured_keeps_its_standard_deviation() -> None:
    bank = NoiseBank(initial())
    for predicted, state, _ in filtered(4.0, 1.0, seed=0):
        bank.add(predicted, state, 1.0)
    assert bank.unexpected_std(state)[0] > 0.0
    assert bank.unexpected_std(state)[SCALE] < 1e-6 * math.sqrt(
        state.covariance[YAW_BIAS + SCALE, YAW_BIAS + SCALE]
    )


def test_a_window_that_forms_the_estimate_says_nothing() -> None:
    bank, start = NoiseBank(initial()), NoiseBank(initial()).weights
    for step, (predicted, state, _) in enumerate(filtered(64.0, 1.0, seed=0)):
        bank.add(predicted, state, 1.0)
        if step == 4:
            assert (bank.weights == start).all()
    assert (bank.weights != start).any()


def test_an_estimate_that_is_let_go_begins_again() -> None:
    """A scale factor that has changed is followed: what was known of it before says nothing any more."""
    bank = NoiseBank(initial())
    for step, (predicted, state, _) in enumerate(filtered(1.0, 1.0, seed=0)):
        if step == 59:
            state = with_bias(state, 1.0, 1.0)
        bank.add(predicted, state, 1.0)
        if step == 59:
            break
    assert (bank.unexpected_std(state) == 0.0).all()


def test_a_coefficient_that_is_known_exactly_stays_so() -> None:
    start = initial()
    known = start.covariance.copy()
    known[YAW_BIAS + SCALE] = known[:, YAW_BIAS + SCALE] = 0.0
    bank = NoiseBank(changed(start, covariance=known))
    for predicted, state, _ in filtered(4.0, 1.0, seed=0):
        bank.add(predicted, changed(state, covariance=state.covariance * (known > 0.0)), 1.0)
    assert bank.unexpected_std(state)[0] > 0.0
    assert bank.unexpected_std(state)[SCALE] == 0.0


def test_what_is_added_to_an_earlier_calibration_is_uncertain_with_any_noise() -> None:
    """A bias that was known before the robot was off is not known any more."""
    bank = NoiseBank(with_bias(initial(), 0.01, 1e-14))
    for predicted, state, _ in filtered(1.0, 1.0, seed=0):
        bank.add(predicted, state, 1.0)
    assert bank.unexpected_std(state)[0] < math.sqrt(state.covariance[YAW_BIAS, YAW_BIAS])
