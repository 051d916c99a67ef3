"""Noise of each feature, learned from its innovations and told by the tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_states import some_state

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.features.feature_noise import (
    MAX_ERROR,
    MIN_FACTOR,
    PRIOR_OBSERVATIONS,
    TypicalMatch,
    learn_noise,
    own_noise,
)
from gyrocal_ros.ekf.features.judged import Judged
from gyrocal_ros.ekf.state.layout import State, unknown_noise

COUNT = 5
ROWS = np.arange(COUNT)


def factors_of(state: State) -> Array:
    """Return the variances of all features relative to a typical one."""
    return own_noise(np.ones((COUNT, 2, 2)), state.landmarks.noise, ROWS)[:, 0, 0]


def learned(state: State, variances: Array, images: int, noise_share: float = 1.0, seed: int = 0) -> State:
    """Return a state that has learned from features with the given true variances, relative to the pixels."""
    rng = np.random.default_rng(seed)
    for _ in range(images):
        assumed = factors_of(state)
        total = noise_share * variances / assumed + 1.0 - noise_share
        distances = total * rng.chisquare(2, COUNT)
        state = learn_noise(state, ROWS, Judged(distances, np.full(COUNT, noise_share), np.nan), 2)
    return state


@pytest.mark.parametrize('noise_share', [1.0, 0.7])
def test_a_worse_feature_is_told_from_the_others(noise_share: float) -> None:
    state = learned(some_state(), np.array([1.0, 1.0, 6.0, 1.0, 1.0]), 300, noise_share)
    factors = factors_of(state)
    assert factors[2] > 2.5 * np.delete(factors, 2).max()


def test_noise_that_all_share_is_left_to_the_pixel_noise() -> None:
    state = learned(some_state(), np.full(COUNT, 4.0), 300)
    assert factors_of(state) == pytest.approx(np.ones(COUNT), abs=0.35)


def test_equal_features_remain_nearly_equal() -> None:
    factors = [factors_of(learned(some_state(), np.ones(COUNT), 200, seed=seed)) for seed in range(10)]
    assert np.mean(factors) == pytest.approx(1.0, abs=0.05)
    assert np.std(factors) < 0.15


def test_few_observations_change_little() -> None:
    state = learn_noise(
        some_state(), ROWS, Judged(np.array([2.0, 2.0, 200.0, 2.0, 2.0]), np.ones(COUNT), np.nan), 2
    )
    factors = factors_of(state)
    assert factors.max() < 1.0 + MAX_ERROR / PRIOR_OBSERVATIONS and np.argmax(factors) == 2


def test_the_factor_has_a_lower_bound() -> None:
    noise = replace(unknown_noise(1), weights=np.array([1000.0]))
    assert own_noise(np.ones((1, 2, 2)), noise, np.array([0]))[0, 0, 0] == MIN_FACTOR


def test_the_typical_match_is_the_geometric_mean_and_follows() -> None:
    typical = TypicalMatch()
    typical.update(np.zeros((0, 2, 2)))
    typical.update(np.array([0.04, 0.16])[:, None, None] ** 2 * np.eye(2))
    assert typical.std_px == pytest.approx(0.08)
    for _ in range(3000):
        typical.update(np.tile(0.3**2 * np.eye(2), (10, 1, 1)))
    assert typical.std_px == pytest.approx(0.3, rel=0.01)
