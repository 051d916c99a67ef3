"""Published covariances of pose and map hold against the room, not only against the first pose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from recordings import recording

from gyrocal_ros.config.sections import Config, WheelConfig
from gyrocal_ros.data import TruthSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.map_frame import point_covariances, pose_covariance
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state import EULER, POSITION, YAW
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
def test_the_published_pose_is_within_its_covariance() -> None:
    """NEES per degree of freedom of x, y and yaw; that of the filter alone is three times as large."""
    published, alone = list[float](), list[float]()
    for seed in range(4):
        source = recording(seed=seed, duration_s=45.0)
        consumer = SlamStream(EkfSlam(default_model(), Config(), source.rig))
        for item in source.measurements():
            if not isinstance(item, TruthSample):
                consumer.step(item)
        state = consumer.slam.state
        time_s = np.array([0.0, (state.t_ns - source.span.start_ns) / 1e9])
        motion, places = source.truth.trajectory.motion(time_s), source.truth.position(time_s)
        start_yaw, yaw = motion.euler_rad[:, 2]
        moved = rotation_from_euler(np.array([0.0, 0.0, start_yaw])).T @ (places[1] - places[0])
        error = np.array([*(state.mean[POSITION] - moved)[:2], state.mean[YAW] - (yaw - start_yaw)])
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        rows = np.ix_([0, 1, 5], [0, 1, 5])
        covariance = state.covariance[:6, :6]
        added = pose_covariance(state.mean[POSITION], state.mean[EULER][2], Config().wheels)
        for nees, matrix in ((alone, covariance), (published, covariance + added)):
            nees.append(float(error @ np.linalg.solve(matrix[rows], error)) / 3.0)
    assert np.mean(published) < 3.0 and np.mean(published) < 0.5 * np.mean(alone)
