"""The initial state of the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_states import MODEL, some_state

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.analysis.examined import with_effect
from gyrocal_ros.effects import find_effect
from gyrocal_ros.ekf.features.landmarks import forget_all
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, POSE, YAW, YAW_BIAS, State
from gyrocal_ros.ekf.state.pauses import inflate_after_gap, restarted_at
from gyrocal_ros.ekf.state.start import Start, aged, initial_state, warmed


def test_a_run_starts_from_its_priors() -> None:
    state = initial_state(MODEL, Config(), None)
    std = np.sqrt(np.diagonal(state.covariance))
    np.testing.assert_array_equal(std[POSE], 0.0)
    np.testing.assert_allclose(std[BIAS], math.radians(1.0))
    np.testing.assert_allclose(std[9:], [item.prior_std for item in MODEL.coefficients])
    np.testing.assert_array_equal(state.mean[9:], [item.prior_mean for item in MODEL.coefficients])


def test_a_run_starts_from_the_result_of_an_earlier_one() -> None:
    """Values go by name, unknown ones are left out, and the bias adds the variance of its prior."""
    names = ('bias', 'scale_temperature', 'scale_cubic', 'scale_factor')
    rng = np.random.default_rng(0)
    mixing = rng.normal(size=(4, 4)) * [[1e-3], [1.0], [1e-4], [1e-3]]
    known = mixing @ mixing.T
    state = initial_state(MODEL, Config(), Start(names, np.array([0.01, 9.0, 0.002, -0.07]), known))
    places, taken = [YAW_BIAS, 10, 9], [0, 2, 3]
    np.testing.assert_array_equal(state.mean[places], [0.01, 0.002, -0.07])
    expected = known[np.ix_(taken, taken)]
    expected[0, 0] += math.radians(1.0) ** 2
    expected[2, 2] += Config().gyro.scale_turn_on_std ** 2
    np.testing.assert_allclose(state.covariance[np.ix_(places, places)], expected)
    fresh = initial_state(MODEL, Config(), None)
    np.testing.assert_array_equal(state.mean[11:], fresh.mean[11:])
    np.testing.assert_array_equal(state.covariance[11:], fresh.covariance[11:])


def test_what_fades_after_power_on_may_have_faded_already() -> None:
    """The strength may be anything down to zero; the time constant is one of the gyro."""
    model = with_effect(MODEL, find_effect('bias_memory:start'))
    names = ('bias', *model.coefficient_names)
    known = Start(names, np.linspace(0.01, 0.02, len(names)), 1e-8 * np.eye(len(names)))
    std = np.sqrt(initial_state(model, Config(), known).covariance.diagonal()[COEFFICIENTS_START:])
    fades = [
        item.unit == 'rad/s' and 'start' in name or name.endswith('amplitude')
        for name, item in zip(model.coefficient_names, model.coefficients, strict=True)
    ]
    assert sum(fades) == 6
    np.testing.assert_allclose(std[1:], np.where(fades, np.hypot(known.values[1:], 1e-4), 1e-4)[1:])


def scale_std(state: State) -> float:
    return math.sqrt(state.covariance[COEFFICIENTS_START, COEFFICIENTS_START])


def test_the_scale_factor_is_known_less_well_after_time_off() -> None:
    """By the random walk, whichever of the two clocks is ahead, and never worse than by the prior."""
    gyro, day_ns = replace(Config().gyro, scale_turn_on_std=0.0), 86_400 * 10**9
    config = replace(Config(), gyro=gyro)
    start = Start(('scale_factor',), np.array([0.02]), np.array([[1e-8]]), 5 * day_ns)
    state = initial_state(MODEL, config, start)
    for days in (-1, 1):
        later = aged(replace(state, t_ns=(5 + days) * day_ns), MODEL, start, gyro)
        assert scale_std(later) == pytest.approx(math.hypot(1e-4, gyro.scale_walk * math.sqrt(86_400)))
    never = aged(replace(state, t_ns=10**9 * day_ns), MODEL, start, gyro)
    assert scale_std(never) == pytest.approx(MODEL.coefficients[0].prior_std)
    unknown = replace(start, end_ns=None)
    assert scale_std(aged(replace(state, t_ns=9 * day_ns), MODEL, unknown, gyro)) == pytest.approx(1e-4)


def test_the_scale_factor_is_known_less_well_at_another_temperature() -> None:
    gyro = replace(Config().gyro, scale_turn_on_std=0.0)
    start = Start(('scale_factor',), np.array([0.02]), np.array([[1e-8]]), temperature_c=45.0)
    state = initial_state(MODEL, replace(Config(), gyro=gyro), start)
    cold = warmed(state, MODEL, start, 20.0, gyro)
    assert scale_std(cold) == pytest.approx(math.hypot(1e-4, 25.0 * gyro.scale_temperature_std))
    for then, now in ((math.nan, 20.0), (45.0, math.nan)):
        same = warmed(state, MODEL, replace(start, temperature_c=then), now, gyro)
        assert scale_std(same) == pytest.approx(1e-4)


def test_a_gap_adds_covariance_to_the_pose() -> None:
    state = forget_all(some_state())
    after = inflate_after_gap(state, 99)
    grown = after.covariance - state.covariance
    assert after.t_ns == 99
    np.testing.assert_array_equal(after.mean, state.mean)
    np.testing.assert_array_equal(np.flatnonzero(np.diagonal(grown)), [0, 1, 2, YAW])
    assert np.count_nonzero(grown) == 4


def test_a_restart_begins_near_the_pose_of_the_state() -> None:
    start, state = initial_state(MODEL, Config(), None), forget_all(some_state())
    after = restarted_at(start, state)
    assert after.t_ns == state.t_ns
    np.testing.assert_array_equal(after.mean[[0, 1, YAW]], state.mean[[0, 1, YAW]])
    np.testing.assert_array_equal(after.mean[2:YAW], 0.0)
    np.testing.assert_array_equal(after.mean[6:], start.mean[6:])
    np.testing.assert_array_equal(after.covariance, inflate_after_gap(start, 0).covariance)
