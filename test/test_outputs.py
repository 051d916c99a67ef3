"""Messages of the calibrator's outputs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from gyrocal_ros.data import CalibratedSample, Mount, OdometryEstimate
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.msgs import outputs
from gyrocal_ros.msgs.to_ros import MessageMaker, transform
from gyrocal_ros.msgs.topics import body_pose, map_frame, transforms
from gyrocal_ros.msgs.transforms import quaternion_from_euler, rotation_from_quaternion
from gyrocal_ros.robot.odom_parent import LISTEN_S, OTHER_TIMEOUT_S, OdomParentGuard

STORE = get_typestore(Stores.ROS2_JAZZY)
MAKE = MessageMaker(STORE.types.__getitem__)
T_NS = 1_700_000_000_123_456_789
ESTIMATE = OdometryEstimate(
    t_ns=T_NS,
    position_m=(1.0, 2.0, 0.1),
    euler_rad=(0.01, -0.02, 3.5),
    pose_covariance=np.arange(36.0).reshape(6, 6),
    speed_m_s=0.3,
    speed_variances=(1e-4, 2e-4, 3e-4),
    rate_rad_s=(0.1, 0.2, 0.3),
    rate_variances=(4e-4, 5e-4, 6e-4),
)


def round_trip(message: Any) -> Any:
    """Serialise and deserialise a message, which fails if a value does not fit its type."""
    name = message.__msgtype__
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, name), name)


@pytest.mark.parametrize('euler', [(0.0, 0.0, 0.0), (0.3, -0.2, 2.5), (-3.0, 1.2, -7.0)])
def test_quaternion_of_euler_angles(euler: tuple[float, float, float]) -> None:
    R = rotation_from_quaternion(*quaternion_from_euler(*euler))
    np.testing.assert_allclose(R, rotation_from_euler(np.array(euler)), atol=1e-12)


def test_calibrated_imu() -> None:
    covariance = np.diag([1e-4, 2e-4, 3e-4])
    rates, forces = (0.1, 0.2, 0.3), (0.0, 0.1, 9.8)
    sample = CalibratedSample(T_NS, rates, (1e-6, 2e-6, 3e-6), forces, (0.0, 0.0, 1.0), covariance)
    message = round_trip(outputs.calibrated_imu(MAKE, sample, 'base_link'))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(T_NS, 10**9)
    assert message.header.frame_id == 'base_link'
    assert message.orientation.z == pytest.approx(math.sin(0.5))
    assert message.orientation_covariance.reshape(3, 3).tolist() == covariance.tolist()
    assert (message.angular_velocity.x, message.angular_velocity.z) == (0.1, 0.3)
    assert np.diagonal(message.angular_velocity_covariance.reshape(3, 3)).tolist() == [1e-6, 2e-6, 3e-6]
    assert message.linear_acceleration.z == 9.8


def test_odometry_estimate() -> None:
    message = round_trip(outputs.odometry_estimate(MAKE, ESTIMATE, 'map', 'base_link'))
    assert (message.header.frame_id, message.child_frame_id) == ('map', 'base_link')
    mount = body_pose(message)
    np.testing.assert_allclose(mount.p_bs, ESTIMATE.position_m)
    np.testing.assert_allclose(mount.R_bs, rotation_from_euler(np.array(ESTIMATE.euler_rad)), atol=1e-12)
    assert message.pose.covariance.tolist() == ESTIMATE.pose_covariance.ravel().tolist()
    assert message.twist.twist.linear.x == 0.3
    assert np.diagonal(message.twist.covariance.reshape(6, 6)).tolist() == [
        1e-4,
        2e-4,
        3e-4,
        4e-4,
        5e-4,
        6e-4,
    ]


def test_map_to_odom_maps_the_body_in_odom_to_the_body_in_the_map() -> None:
    in_odom = Mount(rotation_from_euler(np.array([0.0, 0.0, -1.0])), np.array([4.0, -3.0, 0.0]))
    link = outputs.map_to_odom(ESTIMATE, in_odom, 'map', 'odom')
    [found] = transforms(round_trip(transform(MAKE, T_NS, link)))
    assert (found.parent, found.child) == ('map', 'odom')
    np.testing.assert_allclose(found.mount.R_bs @ in_odom.p_bs + found.mount.p_bs, ESTIMATE.position_m)
    np.testing.assert_allclose(
        found.mount.R_bs @ in_odom.R_bs, rotation_from_euler(np.array(ESTIMATE.euler_rad)), atol=1e-12
    )


@pytest.mark.parametrize(('odom', 'name'), [('odom', 'map'), ('robot1/odom', 'robot1/map'), ('', 'map')])
def test_the_map_has_the_prefix_of_odom(odom: str, name: str) -> None:
    assert map_frame(odom) == name


def test_ceiling_map() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(3, 3, 3)) * 0.1
    covariances = roots @ roots.transpose(0, 2, 1)
    ids = np.array([3, 7, 2**32 - 1])
    message = round_trip(
        outputs.ceiling_map(MAKE, T_NS, 'map', ids, rng.normal(size=(3, 3)), covariances, [5])
    )
    assert [marker.id for marker in message.markers] == [3, 7, -1, 5]
    assert [marker.action for marker in message.markers] == [outputs.ADD] * 3 + [outputs.DELETE]
    for marker, covariance in zip(message.markers, covariances, strict=False):
        q = marker.pose.orientation
        R = rotation_from_quaternion(q.x, q.y, q.z, q.w)
        assert np.linalg.det(R) == pytest.approx(1.0)
        half = np.array([marker.scale.x, marker.scale.y, marker.scale.z]) / 2.0
        sizes = np.sqrt(np.maximum(np.diagonal(R.T @ covariance @ R), (outputs.MIN_DIAMETER_M / 2.0) ** 2))
        np.testing.assert_allclose(half, sizes, rtol=1e-6)


def test_parameter_event() -> None:
    values: dict[str, outputs.ParameterValue] = {
        'a': True,
        'b': 0.5,
        'c': 'text',
        'd': ['one', 'two'],
        'e': [1.0, 2.0],
    }
    message = round_trip(outputs.parameter_event(MAKE, T_NS, '/calibrator', values))
    found = {item.name: item.value for item in message.changed_parameters}
    assert message.node == '/calibrator'
    assert [found[name].type for name in values] == [1, 3, 4, 9, 8]
    assert (found['a'].bool_value, found['b'].double_value, found['c'].string_value) == (True, 0.5, 'text')
    assert list(found['d'].string_array_value) == ['one', 'two']
    assert list(found['e'].double_array_value) == [1.0, 2.0]


# --- the parent of odom ---------------------------------------------------------------------------


def test_map_to_odom_is_sent_only_after_listening() -> None:
    guard = OdomParentGuard(100.0)
    assert not guard.may_send(100.0 + LISTEN_S / 2.0)
    assert guard.may_send(100.0 + LISTEN_S)


def test_own_transforms_are_not_another_publisher() -> None:
    guard = OdomParentGuard(0.0)
    guard.add_own('map', 1)
    guard.add_received('map', 1, 5.0)
    assert guard.may_send(5.0)
    assert not guard.problem(5.0)


@pytest.mark.parametrize('parent', ['map', 'world'])
def test_another_parent_of_odom_suppresses_ours_while_it_is_published(parent: str) -> None:
    guard = OdomParentGuard(0.0)
    guard.add_own('map', 1)
    guard.add_received(parent, 2, 5.0)
    assert not guard.may_send(6.0)
    assert f'the transform from {parent} to odom' in guard.problem(6.0)
    assert guard.may_send(5.0 + OTHER_TIMEOUT_S)


def test_a_static_parent_suppresses_ours_for_good() -> None:
    guard = OdomParentGuard(0.0)
    guard.add_received('world', 2, 5.0, is_static=True)
    assert not guard.may_send(1e6)
