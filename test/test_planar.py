"""The fast variants of the dead reckoning agree with `integrate`, up to errors of the stated order."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
import pytest

from gyrocal_ros.data import Array
from gyrocal_ros.model.kinematics import integrate
from gyrocal_ros.model.planar import Pose, Three, planar_trajectory, step_nearly_level, step_pose

DURATION_S = 0.4
SPEED_M_S = 0.3
START = np.array([0.3, -0.2, 0.1, 0.02, -0.03, 2.0])
RATE = np.array([0.2, -0.3, 1.6])
LEVEL_START, LEVEL_RATE = START * [1, 1, 1, 0, 0, 1], RATE * [0, 0, 1]


def by_integrate(start: Array, rate_rad_s: Array, steps: int) -> Array:
    """Return the pose (6,) after `DURATION_S` at a constant rate, integrated in equal intervals."""
    dt_s = np.full(steps, DURATION_S / steps)
    motion = integrate(start[:3], start[3:], np.tile(rate_rad_s, (steps, 1)), dt_s, SPEED_M_S * dt_s)
    return np.concatenate([motion.position_m, motion.euler_rad])


def by_step_pose(start: Array, rate_rad_s: Array, steps: int) -> Array:
    wx, wy, wz = rate_rad_s.tolist()
    x, y, z, roll, pitch, yaw = start.tolist()
    pose: Pose = (x, y, z, roll, pitch, yaw)
    for _ in range(steps):
        pose = step_pose(pose, (wx, wy, wz), DURATION_S / steps, SPEED_M_S)
    return np.array(pose)


def by_step_nearly_level(start: Array, rate_rad_s: Array, steps: int) -> Array:
    wx, wy, wz = (rate_rad_s * DURATION_S / steps).tolist()
    roll, pitch, yaw = start[3:].tolist()
    euler: Three = (roll, pitch, yaw)
    return np.array(reduce(lambda now, _: step_nearly_level(now, (wx, wy, wz)), range(steps), euler))


def error_of_one_step(dt_s: float) -> float:
    """Return the largest difference of the pose between `step_pose` and `integrate`, for a single step."""
    x, y, z, roll, pitch, yaw = START.tolist()
    wx, wy, wz = RATE.tolist()
    found = step_pose((x, y, z, roll, pitch, yaw), (wx, wy, wz), dt_s, SPEED_M_S)
    step = integrate(START[:3], START[3:], RATE[None], np.array([dt_s]), np.array([SPEED_M_S * dt_s]))
    return float(np.abs(found - np.concatenate([step.position_m, step.euler_rad])).max())


# --- one step in plain floats -------------------------------------------------------------------


def test_step_pose_on_a_level_floor_is_integrate() -> None:
    for steps in (1, 7, 40):
        found = by_step_pose(LEVEL_START, LEVEL_RATE, steps)
        np.testing.assert_allclose(found, by_integrate(LEVEL_START, LEVEL_RATE, steps), atol=1e-14)


def test_error_of_one_step_is_of_second_order() -> None:
    errors = np.array([error_of_one_step(0.1 / 2**halvings) for halvings in range(6)])
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, rtol=0.1)


def test_error_of_step_pose_over_a_time_is_of_first_order() -> None:
    exact = by_integrate(START, RATE, 2000)
    errors = np.array([np.abs(by_step_pose(START, RATE, 20 * 2**n) - exact).max() for n in range(5)])
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.1)
    assert errors[-1] < 1e-3


# --- nearly level -------------------------------------------------------------------------------


def test_the_yaw_of_a_level_body_is_exact() -> None:
    found = by_step_nearly_level(LEVEL_START, LEVEL_RATE, 7)
    np.testing.assert_allclose(found, by_integrate(LEVEL_START, LEVEL_RATE, 7)[3:], atol=1e-14)


def test_error_of_a_small_tilt_is_of_first_order_in_the_step() -> None:
    """The tilt is so small that its square does not count."""
    small = np.array([1e-6, 1e-6, 1.0])
    start, rate = START * [1, 1, 1, *small], RATE * small
    exact = by_integrate(start, rate, 2000)[3:5]
    errors = np.array(
        [np.abs(by_step_nearly_level(start, rate, 20 * 2**n)[:2] - exact).max() for n in range(5)]
    )
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.1)


def test_error_of_the_yaw_is_of_second_order_in_the_tilt() -> None:
    errors = []
    for halvings in range(5):
        small = np.array([0.5**halvings, 0.5**halvings, 1.0])
        start, rate = START * [1, 1, 1, *small], RATE * small
        yaw = by_step_nearly_level(start, rate, 400)[2]
        errors.append(abs(yaw - by_integrate(start, rate, 400)[5]))
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.1)


def test_roll_and_pitch_decay_by_the_factor_that_is_kept() -> None:
    roll, pitch, yaw = step_nearly_level((0.02, -0.03, 2.0), (0.001, 0.002, 0.1))
    decayed = step_nearly_level((0.02, -0.03, 2.0), (0.001, 0.002, 0.1), kept=0.9)
    assert decayed == pytest.approx((0.9 * roll, 0.9 * pitch, yaw))


# --- trajectories on a level floor --------------------------------------------------------------


def driven(steps: int) -> tuple[Array, Array]:
    """Return turns and distances (steps,) of a drive with a rate and a speed that change."""
    edges_s = np.linspace(0.0, 4.0, steps + 1)
    turned, travelled = 0.8 * edges_s + np.sin(edges_s), 0.3 * edges_s - 0.1 * np.cos(edges_s)
    return np.diff(turned), np.diff(travelled)


def planar_by_integrate(turn_rad: Array, distance_m: Array) -> Array:
    """Return x, y and yaw (s, 3) after each step, from the origin."""
    rate, dt_s = np.zeros((len(turn_rad), 3)), np.ones(len(turn_rad))
    rate[:, 2] = turn_rad
    poses = [
        integrate(np.zeros(3), np.zeros(3), rate[:end], dt_s[:end], distance_m[:end])
        for end in range(1, len(turn_rad) + 1)
    ]
    return np.array([[*pose.position_m[:2], pose.euler_rad[2]] for pose in poses])


def test_planar_trajectory_is_integrate_for_the_same_steps() -> None:
    turn_rad, distance_m = driven(30)
    position_m, yaw_rad = planar_trajectory(float(turn_rad[0]), turn_rad, distance_m)
    expected = planar_by_integrate(turn_rad, distance_m)
    np.testing.assert_allclose(position_m, expected[:, :2], atol=1e-13)
    np.testing.assert_allclose(yaw_rad, expected[:, 2], atol=1e-13)


def test_first_yaw_is_that_after_the_first_step() -> None:
    turn_rad, distance_m = driven(30)
    position_m, yaw_rad = planar_trajectory(1.2, turn_rad, distance_m)
    plain_m, _ = planar_trajectory(float(turn_rad[0]), turn_rad, distance_m)
    turned = 1.2 - turn_rad[0]
    assert yaw_rad[0] == pytest.approx(1.2)
    R = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    np.testing.assert_allclose(position_m, plain_m @ R.T, atol=1e-12)


@pytest.mark.slow
def test_error_of_a_planar_trajectory_is_of_second_order() -> None:
    exact = planar_by_integrate(*driven(1000))[-1]
    errors = []
    for halvings in range(5):
        turn_rad, distance_m = driven(10 * 2**halvings)
        position_m, yaw_rad = planar_trajectory(float(turn_rad[0]), turn_rad, distance_m)
        assert yaw_rad[-1] == pytest.approx(exact[2], rel=1e-12)
        errors.append(float(np.linalg.norm(position_m[-1] - exact[:2])))
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.1)
