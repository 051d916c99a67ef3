"""The true trajectory of the simulator: consistent derivatives, manoeuvres and plans."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrocal_ros.data import Array
from gyrocal_ros.sim.manoeuvres import (
    ACCELERATION_M_S2,
    ANGULAR_ACCELERATION_RAD_S2,
    PLANS,
    DrivingStyle,
    arc,
    drive,
    plan_legs,
    turn,
)
from gyrocal_ros.sim.trajectory import GRAVITY_M_S2, Leg, Trajectory, rough_floor


def rough_trajectory(plan: str = 'cleaning', duration_s: float = 60.0, seed: int = 3) -> Trajectory:
    rng = np.random.default_rng(seed)
    legs, start = plan_legs(((plan, 0.0),), 3.0, duration_s, DrivingStyle(), rng)
    return Trajectory(legs, rough_floor(rng, 0.5, 4, 10.0), start)


def test_body_rates_are_the_derivative_of_the_attitude() -> None:
    trajectory = rough_trajectory()
    time_s = np.linspace(1.0, 60.0, 2001)
    h = 1e-5
    before, after = trajectory.motion(time_s - h).R_wb, trajectory.motion(time_s + h).R_wb
    motion = trajectory.motion(time_s)
    skew = np.swapaxes(motion.R_wb, 1, 2) @ (after - before) / (2.0 * h)
    numeric = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    assert np.abs(motion.rate_rad_s[:, :2]).max() > 0.02
    np.testing.assert_allclose(motion.rate_rad_s, numeric, atol=1e-7)


def test_the_robot_moves_along_its_x_axis() -> None:
    trajectory = rough_trajectory()
    time_s = np.linspace(1.0, 60.0, 2001)
    h = 1e-5
    numeric = (trajectory.position(time_s + h) - trajectory.position(time_s - h)) / (2.0 * h)
    motion = trajectory.motion(time_s)
    np.testing.assert_allclose(motion.speed_m_s[:, None] * motion.R_wb[:, :, 0], numeric, atol=1e-8)


def test_specific_force_is_acceleration_minus_gravity() -> None:
    trajectory = rough_trajectory()
    time_s = np.linspace(1.0, 60.0, 2001)
    h = 1e-5
    sides = [trajectory.motion(time_s - h), trajectory.motion(time_s + h)]
    velocities = [side.speed_m_s[:, None] * side.R_wb[:, :, 0] for side in sides]
    motion = trajectory.motion(time_s)
    force_w = (velocities[1] - velocities[0]) / (2.0 * h) + [0.0, 0.0, GRAVITY_M_S2]
    expected = np.einsum('nji,nj->ni', motion.R_wb, force_w)
    np.testing.assert_allclose(motion.specific_force_m_s2, expected, atol=1e-7)


def test_position_is_the_integral_of_the_velocity_up_to_rounding() -> None:
    trajectory = rough_trajectory()

    def displacement(from_s: float, to_s: float, cells: int = 20_000) -> Array:
        """Integrate the velocity by Simpson's rule."""
        motion = trajectory.motion(np.linspace(from_s, to_s, 2 * cells + 1))
        velocity = motion.speed_m_s[:, None] * motion.R_wb[:, :, 0]
        total = velocity[0] + 4.0 * velocity[1::2].sum(0) + 2.0 * velocity[2:-1:2].sum(0) + velocity[-1]
        return (to_s - from_s) / (6.0 * cells) * total

    for from_s, to_s in ((7.0, 7.013), (7.0, 7.4), (6.9, 9.0)):
        start, end = trajectory.position(np.array([from_s, to_s]))
        np.testing.assert_allclose(end - start, displacement(from_s, to_s), atol=1e-9)


def test_distance_and_yaw_are_the_integrals_of_speed_and_yaw_rate() -> None:
    trajectory = Trajectory([*drive(1.0, 0.3), *turn(-2.0, 1.0), *arc(1.0, 0.4, 0.6)])
    cell_s = trajectory.duration_s / 200_000
    motion = trajectory.motion(np.linspace(0.5 * cell_s, trajectory.duration_s - 0.5 * cell_s, 200_000))
    assert cell_s * motion.speed_m_s.sum() == pytest.approx(1.4, abs=1e-8)
    assert cell_s * motion.rate_rad_s[:, 2].sum() == pytest.approx(-1.0, abs=1e-8)
    last = trajectory.motion(np.array([trajectory.duration_s]))
    assert last.travelled_m[0] == pytest.approx(1.4, abs=1e-12)
    assert last.euler_rad[0, 2] == pytest.approx(-1.0, abs=1e-12)


@pytest.mark.parametrize('distance_m', [0.01, 0.3, 2.5])
def test_drive_covers_its_distance(distance_m: float) -> None:
    x, y, yaw = Trajectory(drive(distance_m, 0.3), start=(1.0, 2.0, math.pi / 2.0)).end
    assert (x, y, yaw) == pytest.approx((1.0, 2.0 + distance_m, math.pi / 2.0), abs=1e-12)


@pytest.mark.parametrize('angle_deg', [-3600.0, -90.0, 3.0, 180.0])
def test_turn_stays_on_the_spot(angle_deg: float) -> None:
    end = Trajectory(turn(math.radians(angle_deg), 1.3)).end
    assert end == pytest.approx((0.0, 0.0, math.radians(angle_deg)), abs=1e-12)


@pytest.mark.parametrize('plan', sorted(PLANS))
def test_motion_is_smooth_and_within_the_limits(plan: str) -> None:
    trajectory = rough_trajectory(plan)
    dt = 0.001
    motion = trajectory.motion(np.arange(0.0, 60.0, dt))
    yaw_rate = np.gradient(motion.euler_rad[:, 2], dt)
    assert np.abs(motion.acceleration_m_s2).max() <= ACCELERATION_M_S2 * (1.0 + 1e-9)
    assert np.abs(np.gradient(yaw_rate, dt)).max() <= ANGULAR_ACCELERATION_RAD_S2 * 1.01
    assert np.degrees(np.abs(yaw_rate)).max() <= 90.5
    assert np.abs(np.diff(motion.acceleration_m_s2)).max() < 0.02
    standing = motion.time_s < 3.0
    assert np.all(motion.speed_m_s[standing] == 0.0)
    assert np.all(motion.rate_rad_s[standing] == 0.0)


def test_lanes_turn_equally_often_to_both_sides() -> None:
    driving_style = DrivingStyle(turn_rates_deg_s=(75.0, 75.0), area_m=(2.8, 4.0))
    legs, start = plan_legs((('lanes', 0.0),), 3.0, 300.0, driving_style, np.random.default_rng(0))
    yaw = Trajectory(legs, start=start).motion(np.arange(0.0, 300.0, 0.01)).euler_rad[:, 2]
    assert np.ptp(yaw) == pytest.approx(2.0 * math.pi, abs=1e-6)
    turned = np.abs(np.diff(yaw)).sum()
    assert 36 <= turned / (math.pi / 2.0) <= 44


def test_cleaning_turns_both_ways_at_many_rates_and_stays_in_the_room() -> None:
    trajectory = rough_trajectory('cleaning', 300.0)
    time_s = np.arange(0.0, 300.0, 0.01)
    rate = np.degrees(trajectory.motion(time_s).rate_rad_s[:, 2])
    for low, high in ((30.0, 50.0), (50.0, 70.0), (70.0, 90.0)):
        for side in (-1.0, 1.0):
            assert np.any((rate * side > low) & (rate * side < high)), (low, high, side)
    position = trajectory.position(time_s)
    assert np.abs(position[:, 0]).max() < 2.6
    assert np.abs(position[:, 1]).max() < 2.2
    assert np.abs(position[:, 2]).max() < 0.1


def test_stages_follow_one_another() -> None:
    legs, start = plan_legs(
        (('lanes', 30.0), ('standing', 0.0)), 2.0, 90.0, DrivingStyle(), np.random.default_rng(1)
    )
    trajectory = Trajectory(legs, start=start)
    assert np.any(trajectory.motion(np.arange(2.0, 30.0, 0.1)).speed_m_s > 0.2)
    assert np.all(trajectory.motion(np.arange(60.0, 90.0, 0.1)).speed_m_s == 0.0)


def test_the_robot_stays_in_place_after_the_last_leg() -> None:
    trajectory = Trajectory([*drive(1.0, 0.3), Leg(0.5)])
    late = trajectory.position(np.array([trajectory.duration_s, trajectory.duration_s + 100.0]))
    np.testing.assert_allclose(late[0], late[1])
