"""Published covariances of pose and map hold against the room, not only against the first pose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config, WheelConfig
from gyrocal_ros.data import NS_PER_S, TruthSample, WheelSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import POSITION, YAW
from gyrocal_ros.ekf.state.map import ceiling_map
from gyrocal_ros.ekf.state.map_frame import point_covariances, pose_covariance
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.model.rotation import rotation_from_euler

WHEELS = WheelConfig(scale_std=0.01, floor_tilt_deg=0.3)


def test_they_are_those_of_a_frame_of_wrong_scale_that_leans() -> None:
    """Compared with errors of one standard deviation, one at a time."""
    position, yaw, tilt = np.array([2.0, -3.0, 0.5]), 0.7, math.radians(WHEELS.floor_tilt_deg)
    rotation = rotation_from_euler(np.array([0.0, 0.0, yaw]))
    scaled = np.concatenate([WHEELS.scale_std * position, np.zeros(3)])
    errors = [scaled]
    for axis in np.eye(3)[:2]:
        turned = np.cross(tilt * axis, position)
        errors.append(np.concatenate([turned, rotation.T @ (tilt * axis)]))
    expected = sum(np.outer(error, error) for error in errors)
    np.testing.assert_allclose(pose_covariance(position, yaw, WHEELS), expected, atol=1e-12)
    points = point_covariances(np.stack([position, 2.0 * position]), WHEELS)
    np.testing.assert_allclose(points[0], np.asarray(expected)[:3, :3], atol=1e-12)
    np.testing.assert_allclose(points[1], 4.0 * points[0], atol=1e-12)


@pytest.mark.slow
def test_the_published_covariances_hold_against_the_room() -> None:
    """NEES per degree of freedom, 1 on average: of the features on the floor plan, and of the pose.

    The wheels are larger or smaller than assumed, by as much as the settings expect.
    """
    alone, published, pose_nees = list[float](), list[float](), list[float]()
    wheel_errors = Config().wheels.scale_std * np.random.default_rng(2).normal(size=6)
    for seed, wheel_error in enumerate(wheel_errors.tolist()):
        source = recording(seed=seed, duration_s=45.0)
        consumer, first = SlamStream(EkfSlam(default_model(), Config(), source.rig)), None
        for item in source.measurements():
            if isinstance(item, WheelSample):
                item = replace(item, speed_m_s=(1.0 + wheel_error) * item.speed_m_s)
            if not isinstance(item, TruthSample):
                consumer.step(item)
            if first is None and len(consumer.slam.state.landmarks.ids):
                first = consumer.slam.state  # the map begins here
        assert first is not None
        state, wheels = consumer.slam.state, Config().wheels
        time_s = np.array([one.t_ns - source.span.start_ns for one in (first, state)]) / NS_PER_S
        start, end = source.truth.position(time_s)
        start_yaw, end_yaw = source.truth.trajectory.motion(time_s).euler_rad[:, 2]
        turn = first.mean[YAW] - start_yaw
        R_mw, origin = rotation_from_euler(np.array([0.0, 0.0, turn])), [*first.mean[:2], 0.0]

        error = np.append(state.mean[:2], state.mean[YAW] - end_yaw - turn)
        error[:2] -= (R_mw @ (end - start) + origin)[:2]
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        covariance = state.covariance[:6, :6]
        covariance = covariance + pose_covariance(state.mean[POSITION], state.mean[YAW], wheels)
        pose_nees.append(
            float(error @ np.linalg.solve(covariance[np.ix_([0, 1, 5], [0, 1, 5])], error)) / 3.0
        )

        true = (source.truth.scene.points_w - start) @ R_mw.T + origin
        ceiling = ceiling_map(state, 'inverse_depth')
        added = point_covariances(ceiling.points_m, wheels)
        for point, own, more in zip(ceiling.points_m, ceiling.covariances_m2, added, strict=True):
            off = point - true[np.argmin(np.linalg.norm(true - point, axis=1))]
            if np.linalg.norm(off) < 0.3:  # else it is of another feature
                for nees, matrix in ((alone, own), (published, own + more)):
                    nees.append(float(off[:2] @ np.linalg.solve(matrix[:2, :2], off[:2])) / 2.0)
    assert np.mean(pose_nees) < 1.5
    assert 0.5 < np.mean(published) < 1.5 < np.mean(alone), 'what the wheels may be off has to be added'
