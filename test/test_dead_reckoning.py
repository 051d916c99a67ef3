"""Dead reckoning: calibrated rates, and the present pose by gyro and wheels."""

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
from gyrocal_ros.ekf.equations.effects_by_place import sort_effects
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.state.layout import BIAS, COEFFICIENTS_START, EULER
from gyrocal_ros.ekf.state.start import initial_state
from gyrocal_ros.model.gyro import correct
from gyrocal_ros.model.sensor import SensorModel
from gyrocal_ros.robot.dead_reckoning import DeadReckoning
from gyrocal_ros.sim.world import START_NS

GRAVITY = (0.0, 0.0, 9.8)
NO_MEMORIES = (None,)
"""Memory of the one effect of the default model."""


@cache
def driven(covered_from_s: float = math.inf) -> Robot:
    """Make a robot that has driven for 40 s, with the camera covered from a time on."""
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
    """Return the stamps (n,) and poses (n, 3) x, y, yaw of the ground truth, relative to the first pose."""
    truth = [item for item in source().measurements() if isinstance(item, TruthSample)]
    poses = np.array([(*item.position_m[:2], item.yaw_rad) for item in truth])
    poses[:, 2] = np.unwrap(poses[:, 2])
    cos, sin = math.cos(poses[0, 2]), math.sin(poses[0, 2])
    relative = poses - poses[0]
    relative[:, :2] = relative[:, :2] @ np.array([[cos, -sin], [sin, cos]])
    return np.array([item.t_ns - START_NS for item in truth], float), relative


def errors(estimates: list[OdometryEstimate], from_s: float) -> Array:
    """Return the errors (n, 3) in x, y, yaw from a time on."""
    times, poses = true_poses()
    late = [item for item in estimates if seconds(item.t_ns - START_NS) > from_s]
    estimated = np.array([(*item.position_m[:2], item.euler_rad[2]) for item in late])
    true = np.array([[np.interp(item.t_ns - START_NS, times, pose) for pose in poses.T] for item in late])
    return estimated - true


# --- on a drive -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_rate_errors_agree_with_their_variances() -> None:
    late = [sample for sample in driven().calibrated if sample.t_ns > at(25.0)]
    motion = source().truth.trajectory.motion(np.array([seconds(item.t_ns - START_NS) for item in late]))
    residual = np.array([item.rate_rad_s for item in late]) - motion.rate_rad_s
    sigma = residual / np.sqrt([item.rate_variances for item in late])
    assert np.all(np.abs(sigma.mean(axis=0)) < 0.3)
    assert np.all(sigma.std(axis=0) < 1.5)


@pytest.mark.slow
def test_the_pose_is_accurate_at_its_stamp() -> None:
    error = errors(driven().odometry, 20.0)
    assert np.degrees(np.abs(error[:, 2])).max() < 0.3
    assert np.linalg.norm(error[:, :2], axis=1).max() < 0.1


@pytest.mark.slow
def test_with_the_camera_covered_the_pose_drifts_slowly() -> None:
    robot = driven(25.0)
    error_deg = np.degrees(errors(robot.odometry, 25.0)[:, 2])
    assert np.abs(error_deg).max() < 1.0
    variances = [item.pose_covariance[5, 5] for item in robot.odometry if item.t_ns > at(25.5)]
    assert variances[-1] > 2.0 * variances[0], 'the variance of the unobserved heading grows'


@pytest.mark.slow
def test_every_output_has_the_stamp_of_its_input() -> None:
    robot = driven()
    stamps = [item.t_ns for item in measured() if isinstance(item, ImuSample)]
    assert [sample.t_ns for sample in robot.calibrated] == stamps
    wheels = [item.t_ns for item in measured() if isinstance(item, WheelSample)]
    assert [item.t_ns for item in robot.odometry] == wheels


def test_covariances_are_positive_definite() -> None:
    for sample in driven().calibrated[500::200]:
        assert min(sample.rate_variances) > 0.0
        assert np.linalg.eigvalsh(sample.euler_covariance).min() > 0.0
    for estimate in driven().odometry[500::200]:
        assert min(*estimate.speed_variances, *estimate.rate_variances) > 0.0
        assert np.linalg.eigvalsh(estimate.pose_covariance).min() > -1e-15


# --- on synthetic samples -------------------------------------------------------------------------


def new_reckoning(model: SensorModel | None = None) -> DeadReckoning:
    """Make dead reckoning with the priors of a model as its calibration."""
    model = model or default_model()
    return DeadReckoning(model, Config(), initial_state(model, Config(), None), 0.3)


def turning(
    rate_rad_s: float, from_s: float, to_s: float, speed_m_s: float = 0.0
) -> Iterator[ImuSample | WheelSample]:
    """Yield the measurements of a robot that drives a circle."""
    for tick in range(round(from_s * 100), round(to_s * 100)):
        if tick % 2 == 0:
            yield WheelSample(at(tick / 100), speed_m_s, rate_rad_s)
        yield ImuSample(at(tick / 100), (0.0, 0.0, rate_rad_s), GRAVITY)


def run(reckoning: DeadReckoning, items: Iterator[ImuSample | WheelSample]) -> OdometryEstimate:
    """Process measurements; return the estimate of the last encoder reading."""
    estimate = None
    for item in items:
        if isinstance(item, ImuSample):
            reckoning.imu(item)
        else:
            estimate = reckoning.wheels(item) or estimate
    assert estimate is not None
    return estimate


def test_all_effects_of_the_model_are_applied() -> None:
    effects = [
        {'name': 'scale_factor', 'prior_mean': 0.05},
        {'name': 'scale_cubic', 'prior_mean': 0.01},
        {'name': 'scale_temperature', 'prior_mean': 1e-3},
        {'name': 'gyro_lag', 'prior_mean': 0.02},
    ]
    model = model_from_dict({'name': 'many', 'effects': effects}, 'test')
    reckoning, buffer = new_reckoning(model), MotionBuffer()
    reckoning.imu(ImuSample(at(0.0), (0.0, 0.0, 0.0), GRAVITY))
    for sample in (TemperatureSample(at(0.0), 40.0), *turning(1.2, 0.01, 1.0)):
        buffer.add(sample)
        if isinstance(sample, ImuSample):
            calibrated = reckoning.imu(sample)
        elif isinstance(sample, TemperatureSample):
            reckoning.add(sample)
        else:
            reckoning.wheels(sample)
    effects_by_place = sort_effects(model.effects)
    block: MotionBlock = buffer.cut(at(0.5), at(0.99))
    wanted = correct(
        effects_by_place.gyro, block, effects_by_place.prior_means, effects_by_place.no_memories()
    )
    assert calibrated.rate_rad_s[2] == pytest.approx(1.2 + wanted.rate_rad_s[-1], rel=1e-6)
    assert abs(calibrated.rate_rad_s[2] - 1.2) > 0.05


def test_biases_of_all_axes_are_applied() -> None:
    reckoning = new_reckoning()
    reckoning.imu(ImuSample(at(0.0), (0.0, 0.0, 0.0), GRAVITY))
    state = reckoning.predicted
    mean = state.mean.copy()
    mean[BIAS], mean[COEFFICIENTS_START] = (0.01, 0.02, 0.03), 0.5
    reckoning.recalibrate(replace(state, mean=mean))
    calibrated = reckoning.imu(ImuSample(at(0.01), (0.1, 0.1, 0.1), GRAVITY))
    np.testing.assert_allclose(calibrated.rate_rad_s, (0.11, 0.12, 0.18))


def test_a_circle_is_integrated() -> None:
    rate, speed = 0.5, 0.2
    estimate = run(new_reckoning(), turning(rate, 0.0, 8.0, speed))
    angle = rate * 7.98
    assert estimate.euler_rad[2] == pytest.approx(angle, abs=2e-3)
    radius = speed / rate
    wanted = (radius * math.sin(angle), radius * (1.0 - math.cos(angle)))
    np.testing.assert_allclose(estimate.position_m[:2], wanted, atol=5e-3)


@pytest.mark.parametrize('jump_s', [2.0, -2.0, 1e6, -1e6])
def test_a_jump_of_the_stamps_does_not_move_the_robot(jump_s: float) -> None:
    reckoning = new_reckoning()
    before = run(reckoning, turning(0.5, 0.0, 2.0, 0.2))
    after = run(reckoning, turning(0.5, 2.0 + jump_s, 2.1 + jump_s, 0.2))
    assert after.euler_rad[2] - before.euler_rad[2] == pytest.approx(0.05, abs=0.01)
    assert after.pose_covariance[5, 5] > before.pose_covariance[5, 5]


def test_a_state_of_the_filter_is_predicted_to_the_present() -> None:
    reckoning = new_reckoning()
    run(reckoning, turning(0.5, 0.0, 2.0, 0.2))
    mean = reckoning.predicted.mean.copy()
    mean[:6] = (1.0, 2.0, 0.0, 0.0, 0.0, 3.0)
    assert reckoning.anchor(replace(reckoning.predicted, t_ns=at(1.7), mean=mean), NO_MEMORIES)
    estimate = run(reckoning, turning(0.5, 2.0, 2.02, 0.2))
    assert estimate.euler_rad[2] == pytest.approx(3.0 + 0.3 * 0.5, abs=5e-3)
    assert np.linalg.norm(np.array(estimate.position_m[:2]) - (1.0, 2.0)) == pytest.approx(0.06, abs=5e-3)


@pytest.mark.parametrize('moment_s', [-5.0, 7.0])
def test_a_state_of_another_time_is_refused(moment_s: float) -> None:
    reckoning = new_reckoning()
    run(reckoning, turning(0.5, 0.0, 4.0, 0.2))
    assert not reckoning.anchor(replace(reckoning.predicted, t_ns=at(moment_s)), NO_MEMORIES)


def test_without_the_filter_the_heading_variance_grows() -> None:
    reckoning = new_reckoning()
    variances = [
        run(reckoning, turning(0.1, second, second + 1.0)).pose_covariance[5, 5] for second in range(5)
    ]
    assert all(later > earlier for earlier, later in zip(variances, variances[1:], strict=False))
    assert reckoning.predicted.covariance[EULER, EULER].trace() < 10.0


def test_there_is_no_pose_before_the_first_imu_sample() -> None:
    reckoning = new_reckoning()
    assert reckoning.wheels(WheelSample(at(0.0), 0.1, 0.0)) is None
    reckoning.add(TemperatureSample(at(0.0), 20.0))
    reckoning.imu(ImuSample(at(0.1), (0.0, 0.0, 0.0), GRAVITY))
    assert reckoning.wheels(WheelSample(at(0.1), 0.1, 0.0)) is not None
