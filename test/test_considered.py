"""What no image tells while the camera stays in place is considered, not corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_states import EFFECTS, some_state

from gyrocal_ros.config.sections import Config
from gyrocal_ros.diagnose.examined import with_effect
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.considered import with_considered_view
from gyrocal_ros.ekf.effects_by_place import sort_effects
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.varied import varied_scenario
from gyrocal_ros.sim.world import SimSource

OF_VIEW = [4, 5, 6]
"""Places of turn slip and lateral drift among the coefficients of `filter_states`."""


def test_the_covariance_is_that_of_the_gain_without_the_considered_ones() -> None:
    rng, state = np.random.default_rng(2), some_state()
    P, X = state.covariance, state.sensitivity
    H, R = rng.normal(size=(4, len(P))) / np.sqrt(P.diagonal()), 0.1 * np.eye(4)
    residual = rng.normal(size=4)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    after = replace(
        state, mean=state.mean + gain @ residual, covariance=P - gain @ H @ P, sensitivity=X - gain @ H @ X
    )
    considered = with_considered_view(state, after, sort_effects(EFFECTS))
    gain[state.coefficient_columns.start + np.array(OF_VIEW)] = 0.0
    kept = np.eye(len(P)) - gain @ H
    np.testing.assert_allclose(considered.mean, state.mean + gain @ residual, atol=1e-12)
    np.testing.assert_allclose(considered.covariance, kept @ P @ kept.T + gain @ R @ gain.T, atol=1e-12)
    np.testing.assert_allclose(considered.sensitivity, X - gain @ H @ X, atol=1e-12)


def test_without_such_effects_nothing_changes() -> None:
    state, after = some_state(), some_state(seed=1)
    assert with_considered_view(state, after, sort_effects(EFFECTS[:3])) is after


@pytest.mark.parametrize('effect', ['principal_point', 'camera_position', 'focal_length'])
def test_spins_do_not_tell_where_the_camera_is(effect: str) -> None:
    """A robot that spins for a minute and then drives; its spins alone gave up to 50 sigma."""
    scenario = replace(varied_scenario(7012), duration_s=110.0)
    config = Config()
    config = replace(config, camera=replace(config.camera, pixel_noise_px=scenario.errors.pixel_noise_px))
    model = with_effect(default_model(), find_effect(effect))
    history = calibrate(SimSource(scenario, 7012), config, model).history
    spun = int(np.searchsorted(history.time_s, 60.0))
    columns = slice(10, 9 + history.coefficients.shape[1])
    assert (history.std[spun, columns] > 0.95 * history.std[0, columns]).all()
    assert (history.std[-1, columns] < 0.2 * history.std[0, columns]).all()
    assert (np.abs(history.coefficients[-1, 1:]) < 3.0 * history.std[-1, columns]).all()
