"""Heading references behind a low pass."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, HeadingSample, Measurement
from gyrocal_ros.effects import default_model
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.heading_reference import fit_reference
from gyrocal_ros.pipeline.in_memory import InMemorySource
from gyrocal_ros.pipeline.reference_smoothing import low_passed, with_true_headings
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.world import SimSource

DURATION_S, STEP_S = 40.0, 1e-3


def smoothed_by(time_s: Array, values: Array, time_constant_s: float) -> Array:
    """Integrate a low pass in small steps."""
    steps_s = np.arange(time_s[0], time_s[-1] + STEP_S, STEP_S)
    fine = np.interp(steps_s, time_s, values)
    passed, part = [fine[0]], 1.0 - math.exp(-STEP_S / time_constant_s)
    for value in (0.5 * (fine[1:] + fine[:-1])).tolist():
        passed.append(passed[-1] + (value - passed[-1]) * part)
    return np.interp(time_s, steps_s, passed)


def test_the_low_pass_is_that_of_linear_pieces() -> None:
    time_s = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.02, 300))
    values = np.cumsum(np.random.default_rng(2).standard_normal(300))
    np.testing.assert_allclose(low_passed(time_s, values, 0.1), smoothed_by(time_s, values, 0.1), atol=0.02)
    np.testing.assert_array_equal(low_passed(time_s, values, 0.0), values)


@cache
def behind(time_constant_s: float, kind: str = 'mocap') -> tuple[InMemorySource, ReferenceSource]:
    """Return a recording whose headings passed a low pass, and the one without."""
    scenario = replace(find_scenario('cleaning'), duration_s=DURATION_S, imu_hz=100, camera_hz=5)
    sharp = ReferenceSource(SimSource(scenario, 4), kind)
    source = InMemorySource(sharp.name, sharp.rig, sharp.span, list(sharp.measurements()))
    if time_constant_s == 0.0:
        return source, sharp
    headings = [item for item in source.measurements() if isinstance(item, HeadingSample)]
    stamps_s = np.array([item.t_ns - headings[0].t_ns for item in headings]) / NS_PER_S
    yaw = smoothed_by(stamps_s, np.unwrap([item.yaw_rad for item in headings]), time_constant_s)
    smooth = iter(np.angle(np.exp(1j * yaw)).tolist())
    changed: list[Measurement] = [
        replace(item, yaw_rad=next(smooth)) if isinstance(item, HeadingSample) else item
        for item in source.measurements()
    ]
    return replace(source, loaded=changed), sharp


@pytest.mark.slow
def test_the_time_constant_is_found() -> None:
    source, sharp = behind(0.03)
    found = fit_reference(source.measurements(), 'a recording')
    assert found.time_constant_s == pytest.approx(0.03, rel=0.1) and found.gyro_lag_s == 0.0
    assert found.time_offset_s == pytest.approx(sharp.reference.offset_s + 0.03, abs=2e-3)
    assert found.scale_factor == pytest.approx(sharp.truth.scale_factor, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['mocap', 'lidar'])
def test_a_sharp_reference_has_no_low_pass(kind: str) -> None:
    assert fit_reference(behind(0.0, kind)[0].measurements(), 'a recording').time_constant_s == 0.0


def test_the_headings_are_sharp_again() -> None:
    source, sharp = behind(0.1)
    fitted = replace(
        fit_reference(behind(0.0)[0].measurements(), 'a recording'),
        time_offset_s=sharp.reference.offset_s + 0.1,
        time_constant_s=0.1,
        scale_factor=sharp.truth.scale_factor,
    )
    found = with_true_headings(source.measurements(), fitted, lags=False)
    headings = [item for item in found if isinstance(item, HeadingSample)]
    time_s = np.array([item.t_ns - source.span.start_ns for item in headings]) / NS_PER_S
    true = sharp.truth.trajectory.motion(time_s).euler_rad[:, 2]
    error = np.unwrap([item.yaw_rad for item in headings]) - true
    changes = np.diff(error[time_s > 1.0][::10])
    assert np.abs(changes).max() < 5.0 * sharp.reference.white_rad + math.radians(0.05)


@pytest.mark.slow
def test_a_smoothing_reference_is_not_silently_wrong() -> None:
    """It was off by six standard deviations."""
    source, sharp = behind(0.03)
    run = calibrate(source, Config(), default_model())
    found = conclude(run)
    assert abs(found.scale_factor - sharp.truth.scale_factor) < 3.0 * found.scale_factor_std
    assert any('smooths its headings' in event.text for event in run.events)
