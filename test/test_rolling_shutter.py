"""Images whose rows are exposed one after the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from contracts import CAMERA, FEATURES, FIRST_POSE, NOISE_PX, PIXELS, eventful_block, view_at
from recordings import recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.ekf.equations.effects_by_place import (
    TURN_CHANGE_S,
    PoseMotion,
    as_exposed,
    pose_motion,
    sort_effects,
)
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW
from gyrocal_ros.model.features import PARAMETRISATIONS
from gyrocal_ros.model.kinematics import integrate
from gyrocal_ros.model.sensor import SensorModel, with_means
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.sensors import SensorErrors

READOUT_S = 0.025
SHUTTER: Any = find_effect('rolling_shutter')
FORM = PARAMETRISATIONS['inverse_depth']


@pytest.mark.parametrize('readout_s', [READOUT_S, -READOUT_S])
def test_rows_are_predicted_for_the_moment_of_their_exposure(readout_s: float) -> None:
    """A turn that speeds up shows in a row as far as it has come when the row is exposed."""
    motion = PoseMotion(np.array([0, 0, 0, 0, 0, 0.4]), np.array([0, 0, 0, 0, 0, 5.0]))
    first = FORM.initialise(view_at(FIRST_POSE), PIXELS, NOISE_PX, FEATURES)
    view = view_at(FIRST_POSE)
    at_stamp = FORM.predict(view, first.parameters, first.anchors)
    seen = as_exposed(sort_effects((SHUTTER,)), view, at_stamp, motion, np.array([readout_s])).expected
    moved_px = 0.0
    for feature, pixel in enumerate(seen):
        delay_s = readout_s * ((pixel[1] + 0.5) / CAMERA.height_px - 0.5)
        pose = FIRST_POSE + motion.rate * delay_s + 0.5 * motion.acceleration * delay_s**2
        then = FORM.predict(view_at(pose), first.parameters, first.anchors).expected[feature]
        np.testing.assert_allclose(pixel, then, atol=0.01)
        moved_px = max(moved_px, float(np.abs(then - at_stamp.expected[feature]).max()))
    assert moved_px > 0.5


def test_the_yaw_acceleration_is_that_before_the_image() -> None:
    block = eventful_block()
    ends_s = block.dt_s.cumsum()
    late = ends_s - block.dt_s > ends_s[-1] - TURN_CHANGE_S
    block = replace(block, yaw_acceleration_rad_s2=np.where(late, 4.0, -50.0))
    cut = np.flatnonzero(late)[0] - 1
    block.yaw_acceleration_rad_s2[cut] = 4.0  # of this interval only a part counts
    step = integrate(np.zeros(3), np.zeros(3), block.rate_rad_s, block.dt_s, block.distance_m)
    motion = pose_motion(step, block)
    np.testing.assert_array_equal(motion.rate, step.pose_rate)
    np.testing.assert_allclose(motion.acceleration, 4.0 * (np.arange(6) == YAW))


def test_one_interval_alone_tells_the_yaw_acceleration() -> None:
    """As where the camera is faster than the IMU."""
    block = eventful_block(1)
    step = integrate(np.zeros(3), np.zeros(3), block.rate_rad_s, block.dt_s, block.distance_m)
    assert pose_motion(step, block).acceleration[YAW] == pytest.approx(block.yaw_acceleration_rad_s2[0])


@pytest.mark.slow
def test_a_known_readout_leaves_the_scale_factor_as_it_is() -> None:
    """Turns that begin and end within some images do not look smaller than they are."""
    item = replace(SHUTTER.coefficients[0], prior_std=1e-9)
    known = with_means(replace(SHUTTER, coefficients=(item,)), (READOUT_S,))
    bare = default_model()
    model = SensorModel('with it', bare.bias, (*bare.effects, known))
    images = {
        'seed': 30,
        'duration_s': 30.0,
        'imu_hz': 200,
        'camera_hz': 30,
        'errors': SensorErrors(pixel_noise_px=0.1),
    }
    plain = calibrate(recording(**images), Config(), bare)
    rolling = calibrate(recording(**images, hidden=(HiddenEffect(SHUTTER, (READOUT_S,)),)), Config(), model)
    scales = [1.0 + run.state.mean[COEFFICIENTS_START] for run in (plain, rolling)]
    assert scales[1] == pytest.approx(scales[0], rel=1e-5)


@pytest.mark.slow
def test_only_turns_tell_the_readout() -> None:
    """What the rows do straight on looks like other depths."""
    source = recording('lanes', 2, 40.0, (HiddenEffect(SHUTTER, (READOUT_S,)),))
    base = default_model()
    history = calibrate(source, Config(), replace(base, effects=(*base.effects, SHUTTER))).history
    readout_s, std_s = history.mean[:, -1], history.std[:, -1]
    way_m_s = history.distance_m / history.dt_s
    turned_rad = np.abs(history.turn_rad).cumsum()
    before = np.flatnonzero(turned_rad < 0.05)[-1]
    assert history.distance_m[:before].sum() > 0.5 and way_m_s[before] > 0.0
    assert std_s[before] > 0.9 * SHUTTER.coefficients[0].prior_std
    assert std_s[-1] < 0.001 and abs(readout_s[-1] - READOUT_S) < 3.0 * std_s[-1]
