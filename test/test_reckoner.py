"""The calibration applied at once: true rates, and the pose of now by gyro and wheels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from live_robot import Robot, measured, source, switched_on
from recordings import at

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import (
    Array,
    FeatureObservations,
    ImuSample,
    MotionBlock,
    OdometryEstimate,
    TemperatureSample,
    TruthSample,
    WheelSample,
    seconds,
)
from gyrocal_ros.effects import default_model
from gyrocal_ros.effects.model_file import model_from_dict
from gyrocal_ros.ekf.effects_by_place import sort_effects
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.start import initial_state
from gyrocal_ros.ekf.state import BIAS, COEFFICIENTS_START, EULER
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.robot.dead_reckoning import DeadReckoning
from gyrocal_ros.sim.world import START_NS

GRAVITY = (0.0, 0.0, 9.8)
NOTHING = (None,)
"""What the one effect of the default model remembers."""


@cache
def driven(covered_from_s: float = math.inf) -> Robot:
    """A robot that has driven for 40 s, perhaps with the camera covered towards the end."""
    new = switched_on()
    seen = (
        item
        for item in measured()
        if not isinstance(item, FeatureObservations) or seconds(item.t_ns - START_NS) < covered_from_s
    )
    new.run(seen)
    return new


@cache
def true_poses() -> tuple[Array, Array]:
    """(n,) stamps and (n, 3) x, y, yaw of the ground truth, from where the robot began."""
    truth = [item for item in source().measurements() if isinstance(item, TruthSample)]
    poses = np.array([(*item.position_m[:2], item.yaw_rad) for item in truth])
    poses[:, 2] = np.unwrap(poses[:, 2])
    cos, sin = math.cos(poses[0, 2]), math.sin(poses[0, 2])
    moved = poses - poses[0]
    moved[:, :2] = moved[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    return np.array([item.t_ns - START_NS for item in truth], float), moved


def errors(places: list[OdometryEstimate], from_s: float) -> Array:
    """(n, 3) x, y, yaw by which the robot is off, from a time on."""
    times, poses = true_poses()
    late = [place for place in places if seconds(place.t_ns - START_NS) > from_s]
    found = np.array([(*place.position_m[:2], place.euler_rad[2]) for place in late])
    wanted = np.array([[np.interp(place.t_ns - START_NS, times, pose) for pose in poses.T] for place in late])
    return found - wanted


# --- on a drive -----------------------------------------------------------------------------------


def test_rates_are_true_within_their_variances() -> None:
    late = [sample for sample in driven().calibrated if sample.t_ns > at(25.0)]
    motion = source().truth.trajectory.motion(np.array([seconds(item.t_ns - START_NS) for item in late]))
    residual = np.array([item.rate_rad_s for item in late]) - motion.rate_rad_s
    sigma = residual / np.sqrt([item.rate_variances for item in late])
    assert np.all(np.abs(sigma.mean(axis=0)) < 0.3)
    assert np.all(sigma.std(axis=0) < 1.5)


def test_the_pose_is_that_of_now() -> None:
    error = errors(driven().located, 20.0)
    assert np.degrees(np.abs(error[:, 2])).max() < 0.3
    assert np.linalg.norm(error[:, :2], axis=1).max() < 0.1


def test_with_the_camera_covered_the_calibration_carries_on() -> None:
    robot = driven(25.0)
    error_deg = np.degrees(errors(robot.located, 25.0)[:, 2])
    assert np.abs(error_deg).max() < 1.0
    doubt = [place.pose_covariance[5, 5] for place in robot.located if place.t_ns > at(25.5)]
    assert doubt[-1] > 2.0 * doubt[0], 'and it is told that nobody sees the heading'


def test_every_sample_and_reading_is_answered_with_its_own_stamp() -> None:
    robot = driven()
    stamps = [item.t_ns for item in measured() if isinstance(item, ImuSample)]
    assert [sample.t_ns for sample in robot.calibrated] == stamps
    wheels = [item.t_ns for item in measured() if isinstance(item, WheelSample)]
    assert [place.t_ns for place in robot.located] == wheels


def test_covariances_are_ones() -> None:
    for sample in driven().calibrated[500::200]:
        assert min(sample.rate_variances) > 0.0
        assert np.linalg.eigvalsh(sample.euler_covariance).min() > 0.0
    for place in driven().located[500::200]:
        assert min(*place.speed_variances, *place.rate_variances) > 0.0
        assert np.linalg.eigvalsh(place.pose_covariance).min() > -1e-15


# --- by hand --------------------------------------------------------------------------------------


def reckoner(model: SensorModel | None = None) -> DeadReckoning:
    """One whose calibration is that of the model's priors."""
    model = model or default_model()
    return DeadReckoning(model, Config(), initial_state(model, Config(), None), 0.3)


def turning(
    rate_rad_s: float, from_s: float, to_s: float, speed_m_s: float = 0.0
) -> Iterator[ImuSample | WheelSample]:
    """What a robot measures that drives a circle."""
    for tick in range(round(from_s * 100), round(to_s * 100)):
        if tick % 2 == 0:
            yield WheelSample(at(tick / 100), speed_m_s, rate_rad_s)
        yield ImuSample(at(tick / 100), (0.0, 0.0, rate_rad_s), GRAVITY)


def go(reckoner: DeadReckoning, items: Iterator[ImuSample | WheelSample]) -> OdometryEstimate:
    """Let it take them; where it is after the last reading of the wheels."""
    place = None
    for item in items:
        if isinstance(item, ImuSample):
            reckoner.imu(item)
        else:
            place = reckoner.wheels(item) or place
    assert place is not None
    return place


def test_all_effects_of_the_model_count() -> None:
    effects = [
        {'name': 'scale_factor', 'prior_mean': 0.05},
        {'name': 'scale_cubic', 'prior_mean': 0.01},
        {'name': 'scale_temperature', 'prior_mean': 1e-3},
        {'name': 'gyro_lag', 'prior_mean': 0.02},
    ]
    model = model_from_dict({'name': 'many', 'effects': effects}, 'test')
    own, buffer = reckoner(model), MotionBuffer()
    own.imu(ImuSample(at(0.0), (0.0, 0.0, 0.0), GRAVITY))
    for sample in (TemperatureSample(at(0.0), 40.0), *turning(1.2, 0.01, 1.0)):
        buffer.add(sample)
        if isinstance(sample, ImuSample):
            said = own.imu(sample)
        elif isinstance(sample, TemperatureSample):
            own.add(sample)
        else:
            own.wheels(sample)
    parts = sort_effects(model.effects)
    block: MotionBlock = buffer.cut(at(0.5), at(0.99))
    wanted = correct(parts.gyro, block, parts.prior_means, parts.no_memories())
    assert said.rate_rad_s[2] == pytest.approx(1.2 + wanted.rate_rad_s[-1], rel=1e-6)
    assert abs(said.rate_rad_s[2] - 1.2) > 0.05


def test_biases_of_all_axes_count() -> None:
    own = reckoner()
    own.imu(ImuSample(at(0.0), (0.0, 0.0, 0.0), GRAVITY))
    state = own.ahead
    mean = state.mean.copy()
    mean[BIAS], mean[COEFFICIENTS_START] = (0.01, 0.02, 0.03), 0.5
    own.recalibrate(replace(state, mean=mean))
    said = own.imu(ImuSample(at(0.01), (0.1, 0.1, 0.1), GRAVITY))
    np.testing.assert_allclose(said.rate_rad_s, (0.11, 0.12, 0.18))


def test_a_circle_is_driven() -> None:
    rate, speed = 0.5, 0.2
    place = go(reckoner(), turning(rate, 0.0, 8.0, speed))
    angle = rate * 7.98
    assert place.euler_rad[2] == pytest.approx(angle, abs=2e-3)
    radius = speed / rate
    wanted = (radius * math.sin(angle), radius * (1.0 - math.cos(angle)))
    np.testing.assert_allclose(place.position_m[:2], wanted, atol=5e-3)


@pytest.mark.parametrize('leap_s', [2.0, -2.0, 1e6, -1e6])
def test_stamps_that_leap_do_not_move_the_robot(leap_s: float) -> None:
    own = reckoner()
    before = go(own, turning(0.5, 0.0, 2.0, 0.2))
    after = go(own, turning(0.5, 2.0 + leap_s, 2.1 + leap_s, 0.2))
    assert after.euler_rad[2] - before.euler_rad[2] == pytest.approx(0.05, abs=0.01)
    assert after.pose_covariance[5, 5] > before.pose_covariance[5, 5]


def test_a_state_of_the_filter_is_carried_on_to_now() -> None:
    own = reckoner()
    go(own, turning(0.5, 0.0, 2.0, 0.2))
    mean = own.ahead.mean.copy()
    mean[:6] = (1.0, 2.0, 0.0, 0.0, 0.0, 3.0)
    assert own.anchor(replace(own.ahead, t_ns=at(1.7), mean=mean), NOTHING)
    place = go(own, turning(0.5, 2.0, 2.02, 0.2))
    assert place.euler_rad[2] == pytest.approx(3.0 + 0.3 * 0.5, abs=5e-3)
    assert np.linalg.norm(np.array(place.position_m[:2]) - (1.0, 2.0)) == pytest.approx(0.06, abs=5e-3)


@pytest.mark.parametrize('moment_s', [-5.0, 7.0])
def test_a_state_of_another_time_is_not(moment_s: float) -> None:
    own = reckoner()
    go(own, turning(0.5, 0.0, 4.0, 0.2))
    assert not own.anchor(replace(own.ahead, t_ns=at(moment_s)), NOTHING)


def test_left_alone_it_doubts_more_and_more() -> None:
    own = reckoner()
    doubts = [go(own, turning(0.1, second, second + 1.0)).pose_covariance[5, 5] for second in range(5)]
    assert all(later > earlier for earlier, later in zip(doubts, doubts[1:], strict=False))
    assert own.ahead.covariance[EULER, EULER].trace() < 10.0


def test_before_the_imu_has_spoken_nobody_knows() -> None:
    own = reckoner()
    assert own.wheels(WheelSample(at(0.0), 0.1, 0.0)) is None
    own.add(TemperatureSample(at(0.0), 20.0))
    own.imu(ImuSample(at(0.1), (0.0, 0.0, 0.0), GRAVITY))
    assert own.wheels(WheelSample(at(0.1), 0.1, 0.0)) is not None
