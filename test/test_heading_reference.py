"""The fit of a heading reference to the gyro over a recording."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, HeadingSample, ImuSample, Measurement
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.errors import NotObservableError
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.heading_reference import fit_reference
from gyrocal_ros.pipeline.reference_fit import ReferenceFit
from gyrocal_ros.pipeline.reference_readings import Readings, track_at
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import SensorErrors
from gyrocal_ros.sim.world import SimSource

SCALE_FACTOR, BIAS_RAD_S = 0.94, math.radians(0.3)
IMU_HZ, REFERENCE_HZ, DURATION_S = 50.0, 5.0, 80.0
NOISE_RAD, JUMP_DEG = math.radians(0.1), 3.0

Rate = Callable[[Array], Array]
Present = Callable[[Array], NDArray[np.bool_]]


def turning(time_s: Array) -> Array:
    """Turn to and fro at 100 deg/s, five seconds each."""
    return math.radians(100.0) * np.sign(np.sin(2.0 * math.pi * time_s / 10.0))


def swinging(time_s: Array) -> Array:
    """Swing by 34 deg to and fro, once in two seconds."""
    return math.radians(17.0) * math.pi * np.cos(math.pi * time_s)


def seldom_turning(time_s: Array) -> Array:
    """Turn like that for one second of ten."""
    return np.where(time_s % 5.0 < 0.5, turning(time_s), 0.0)


def everywhere(time_s: Array) -> NDArray[np.bool_]:
    return np.ones(len(time_s), bool)


def outside(start_s: float, end_s: float) -> Present:
    return lambda time_s: (time_s < start_s) | (time_s >= end_s)


def recorded(
    rate: Rate, imu: Present = everywhere, reference: Present = everywhere, noise_rad: float = NOISE_RAD
) -> list[Measurement]:
    """Return a recording: nominal rates with a scale error and a bias, and noisy wrapped headings."""
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, DURATION_S, 1.0 / IMU_HZ)
    true = rate(time_s)
    yaw = np.cumsum(true) / IMU_HZ
    nominal = (true - BIAS_RAD_S) / SCALE_FACTOR + 1e-3 * rng.standard_normal(len(time_s))
    heading_s = np.arange(0.05, DURATION_S, 1.0 / REFERENCE_HZ)
    headings = np.interp(heading_s, time_s, yaw) + noise_rad * rng.standard_normal(len(heading_s))
    wrapped = np.angle(np.exp(1j * headings))
    samples: list[Measurement] = [
        ImuSample(round(t * 1e9), (0.0, 0.0, r), (0.0, 0.0, 9.8))
        for t, r in zip(time_s[imu(time_s)].tolist(), nominal[imu(time_s)].tolist(), strict=True)
    ]
    kept = reference(heading_s)
    samples += map(
        HeadingSample, np.round(heading_s[kept] * 1e9).astype(int).tolist(), wrapped[kept].tolist()
    )
    return sorted(samples, key=lambda item: item.t_ns)


def fitted(rate: Rate, imu: Present = everywhere, reference: Present = everywhere) -> ReferenceFit:
    return fit_reference(recorded(rate, imu, reference), 'a recording')


def test_swings_that_add_up_are_turns() -> None:
    found = fitted(swinging)
    assert found.scale_factor == pytest.approx(SCALE_FACTOR, rel=3e-3)
    assert found.bias_rad_s == pytest.approx(BIAS_RAD_S, abs=1e-3)


def test_a_reference_may_err_only_while_the_robot_turns() -> None:
    """Encoders: exact at rest, where the robot spends most of its time."""
    samples, rng, slip_rad = recorded(seldom_turning, noise_rad=0.0), np.random.default_rng(2), 0.0
    yaw_before: float | None = None
    changed: list[Measurement] = []
    for sample in samples:
        if isinstance(sample, HeadingSample):
            turned = 0.0 if yaw_before is None else math.remainder(sample.yaw_rad - yaw_before, 2.0 * math.pi)
            yaw_before = sample.yaw_rad
            slip_rad += 0.02 * math.sqrt(abs(turned)) * rng.standard_normal()
            changed.append(replace(sample, yaw_rad=sample.yaw_rad + slip_rad))
        else:
            changed.append(sample)
    found = fit_reference(changed, 'a recording')
    assert found.scale_factor == pytest.approx(SCALE_FACTOR, rel=0.02)


def test_a_bias_and_noise_are_no_turns() -> None:
    with pytest.raises(NotObservableError, match='no turns'):
        fitted(lambda time_s: np.zeros(len(time_s)))


def test_a_gap_of_the_reference_in_which_the_robot_turns_is_no_misfit() -> None:
    """Fifteen seconds at 100 deg/s: the headings alone do not tell how many turns they were."""
    whole, gapped = fitted(turning), fitted(turning, reference=outside(40.0, 54.0))
    assert gapped.scale_factor == pytest.approx(SCALE_FACTOR, rel=2e-3)
    assert math.degrees(gapped.residual_rms_rad) < 2.0 * math.degrees(whole.residual_rms_rad) + 0.05
    assert gapped.walk_rad < 2.0 * whole.walk_rad + 1e-4


def test_a_pause_of_the_gyro_hides_only_the_turn_within() -> None:
    """Nor is the unknown turn within a misfit of the reference."""
    found = fitted(turning, imu=outside(31.0, 57.0), reference=outside(31.0, 57.0))
    assert math.degrees(found.residual_rms_rad) < 1.0
    assert found.scale_factor == pytest.approx(SCALE_FACTOR, rel=2e-3)
    assert found.bias_rad_s == pytest.approx(BIAS_RAD_S, abs=2e-3)


@pytest.mark.parametrize('before_s', [0.0, 0.3, 0.8])
def test_a_jump_just_before_the_first_turn_is_no_random_walk(before_s: float) -> None:
    """Nothing then tells it from an error of the scale factor but the turns that follow."""

    def first_at_rest(time_s: Array) -> Array:
        return np.where(time_s < 10.0, 0.0, turning(time_s))

    samples = recorded(first_at_rest)
    jumped = [
        replace(item, yaw_rad=item.yaw_rad + math.radians(JUMP_DEG))
        if isinstance(item, HeadingSample) and item.t_ns >= (10.0 - before_s) * NS_PER_S
        else item
        for item in samples
    ]
    still, found = (fit_reference(items, 'a recording') for items in (samples, jumped))
    assert found.walk_rad < 2.0 * still.walk_rad
    assert found.scale_factor == pytest.approx(SCALE_FACTOR, rel=3e-3)


def test_the_fit_goes_on_after_a_step_of_the_clock() -> None:
    samples = recorded(turning)
    half = len(samples) // 2
    step = ClockStep(samples[half].t_ns - 50 * NS_PER_S, -50 * NS_PER_S)
    later = [replace(item, t_ns=item.t_ns - 50 * NS_PER_S) for item in samples[half:]]  # type: ignore[type-var]
    found = fit_reference([*samples[:half], step, *later], 'a recording')
    assert found.scale_factor == pytest.approx(SCALE_FACTOR, rel=2e-3)
    assert found.bias_rad_s == pytest.approx(BIAS_RAD_S, abs=2e-3)


def test_the_bias_is_as_doubtful_as_the_gyro_is_noisy() -> None:
    """With the noise of the settings alone a noisy gyro seemed as well known at rest as a quiet one."""

    def bias_std(times: float) -> float:
        errors = replace(SensorErrors(), rate_noise_deg_s=times * SensorErrors().rate_noise_deg_s)
        changed = replace(find_scenario('rest_and_go'), duration_s=40.0, imu_hz=100, errors=errors)
        source = ReferenceSource(SimSource(changed, 2), 'lidar')
        return float(conclude(calibrate(source, Config(), default_model())).stds[0])

    quiet, usual, noisy = bias_std(0.4), bias_std(1.0), bias_std(3.0)
    assert quiet < 0.8 * usual and noisy > 2.0 * usual


def test_what_the_temperature_does_to_the_bias_is_no_noise_of_the_reference() -> None:
    drive = replace(find_scenario('cleaning'), duration_s=90.0, imu_hz=100, camera_hz=1)
    hidden = (HiddenEffect(find_effect('bias_temperature'), (math.radians(0.1),)),)
    source = ReferenceSource(SimSource(drive, 6, hidden=hidden), 'mocap')
    found = fit_reference(source.measurements(), 'here')
    assert found.bias_walk_deg_s > 4.0 * Config().gyro.bias_walk_deg_s
    of_both = math.hypot(source.reference.walk_rad, math.radians(Config().gyro.rate_noise_deg_s))
    assert found.walk_rad < 1.5 * of_both


@pytest.mark.slow
@pytest.mark.parametrize('scale_factor', [1.0, 1.01])
def test_a_scale_factor_of_exactly_one_is_suspicious(scale_factor: float) -> None:
    """It is that of a reference that is computed from the gyro."""
    scenario = replace(find_scenario('cleaning'), duration_s=60.0, imu_hz=100, camera_hz=1)
    changed = replace(scenario, errors=replace(scenario.errors, scale_factor=scale_factor))
    run = calibrate(ReferenceSource(SimSource(changed, 4), 'mocap'), Config(), default_model())
    suspicious = [event.text for event in run.events if 'computed from this gyro' in event.text]
    assert len(suspicious) == (scale_factor == 1.0)


def test_a_turn_that_begins_between_two_samples_is_not_cut() -> None:
    """Along lines between the samples the heading would lag by up to 0.05 deg."""
    time_s = np.arange(0.0, 5.0, 0.04)
    none, heading_s = np.zeros(len(time_s)), np.arange(0.5, 4.5, 0.033)
    readings = Readings(time_s, 4.0 * time_s, 2.0 * time_s**2, none, 0.0, heading_s, 2.0 * heading_s**2)
    found = track_at(readings, 0.0)
    np.testing.assert_allclose(found.turned_rad, 2.0 * heading_s**2, atol=1e-9)
    np.testing.assert_allclose(found.rate_rad_s, 4.0 * heading_s, atol=1e-9)


def test_a_gap_of_the_gyro_is_bridged_by_a_line() -> None:
    """A spline would run on at the rate before it, for as long as the gap is."""
    time_s = np.concatenate([np.arange(0.0, 2.0, 0.1), np.arange(10.0, 12.0, 0.1)])
    turned = np.where(time_s < 5.0, time_s, time_s - 8.0)
    none, heading_s = np.zeros(len(time_s)), np.arange(0.5, 11.5, 0.25)
    found = track_at(
        Readings(time_s, np.ones(len(time_s)), turned, none, 0.0, heading_s, 0.0 * heading_s), 0.0
    )
    np.testing.assert_allclose(found.turned_rad, np.interp(heading_s, time_s, turned), atol=1e-9)
