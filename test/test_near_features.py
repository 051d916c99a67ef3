"""Features that are nearer than a ceiling: a robot below tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contracts import CAMERA, FEATURES, FIRST_POSE, NOISE_PX, PIXELS, view_at
from filter_states import INVERSE_DEPTH
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import Array
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.equations.update import Innovation, innovate
from gyrocal_ros.ekf.features.landmarks import augment
from gyrocal_ros.ekf.features.near_features import DEPTH, NEAR_STD_1_M, with_near_features
from gyrocal_ros.ekf.state.layout import State
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude

CEILING_M = FEATURES.prior_depth_m
ROWS = np.arange(len(PIXELS))


def seen_from_beside(depth_m: float) -> tuple[State, Innovation]:
    """Return a map of features seen once, and their innovation 0.1 m beside, at a depth."""
    view, pose = view_at(FIRST_POSE), FIRST_POSE + np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    first = INVERSE_DEPTH.initialise(view, PIXELS, NOISE_PX, FEATURES)
    rays = np.column_stack([bearing(CAMERA, PIXELS), np.ones(len(PIXELS))])
    state = initial_state(default_model(), Config(), None, 0)
    state = augment(state, ROWS, PIXELS, bearing(CAMERA, PIXELS), first, None, None)
    beside = view_at(pose)
    points_c = (depth_m * rays @ view.R_wc.T + view.p_wc - beside.p_wc) @ beside.R_wc
    prediction = INVERSE_DEPTH.predict(beside, state.features, state.anchors_of(ROWS))
    noise = np.broadcast_to(NOISE_PX**2 * np.eye(2), (len(ROWS), 2, 2))
    return state, innovate(state, ROWS, prediction, project(CAMERA, points_c), noise)


def depth_stds(state: State) -> Array:
    stds: Array = np.sqrt(state.covariance.diagonal()[state.feature_columns(ROWS)[:, DEPTH]])
    return stds


def test_a_feature_far_below_the_ceiling_has_an_unknown_depth() -> None:
    state, innovation = seen_from_beside(0.4)
    near = with_near_features(state, innovation, FEATURES)
    assert depth_stds(near) == pytest.approx(np.hypot(depth_stds(state), NEAR_STD_1_M))
    np.testing.assert_array_equal(near.mean, state.mean)


@pytest.mark.parametrize('depth_m', [1.5, CEILING_M, 50.0])
def test_other_features_keep_their_depth(depth_m: float) -> None:
    state, innovation = seen_from_beside(depth_m)
    assert with_near_features(state, innovation, FEATURES) is state


def test_one_of_known_depth_does_not_lose_it() -> None:
    """What contradicts it is another point."""
    state, innovation = seen_from_beside(0.4)
    places = state.feature_columns(ROWS)[:, DEPTH]
    covariance = state.covariance.copy()
    covariance[places] *= 0.1
    covariance[:, places] *= 0.1
    known = replace(state, covariance=covariance)
    assert with_near_features(known, innovation, FEATURES) is known


@pytest.mark.parametrize('seed', [1, 4])
def test_a_robot_below_tables_keeps_its_map(seed: int) -> None:
    """Their undersides contradicted it, so that it was dropped."""
    source = recording('tables', seed, 120.0)
    run = calibrate(source, Config(), default_model(), follows_changes=True)
    found, true = conclude(run), source.truth.scale_factor
    assert not run.events and found.converged
    assert abs(found.scale_factor - true) < 3.0 * found.scale_factor_std
