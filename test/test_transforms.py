"""Rotations of messages, compared with SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from gyrocal_ros.msgs.transforms import (
    quaternion_from_euler,
    quaternion_from_rotation,
    quaternion_from_yaw,
    rotation_from_quaternion,
    yaw_from_quaternion,
)

EULER_RAD = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))


@pytest.mark.parametrize('euler_rad', EULER_RAD, ids=range(len(EULER_RAD)))
def test_rotations_are_those_of_scipy(euler_rad: np.ndarray) -> None:
    roll, pitch, yaw = euler_rad.tolist()
    expected = Rotation.from_euler('ZYX', [yaw, pitch, roll])
    quaternion = quaternion_from_euler(roll, pitch, yaw)
    assert abs(np.dot(quaternion, expected.as_quat())) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(rotation_from_quaternion(*quaternion), expected.as_matrix(), atol=1e-12)
    back = quaternion_from_rotation(expected.as_matrix())
    assert abs(np.dot(back, expected.as_quat())) == pytest.approx(1.0, abs=1e-12)
    assert yaw_from_quaternion(*quaternion) == pytest.approx(yaw, abs=1e-12)
    assert abs(np.dot(quaternion_from_yaw(yaw), Rotation.from_euler('z', yaw).as_quat())) == pytest.approx(
        1.0
    )
