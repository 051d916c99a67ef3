"""Scale errors of the x and y gyros, which are not estimated, on a floor with door sills."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ImuSample
from gyrocal_ros.diagnose.analysis.summarise import summarise_recording
from gyrocal_ros.diagnose.diagnosis import Diagnosis, diagnose
from gyrocal_ros.diagnose.noise import find_missing
from gyrocal_ros.effects import default_model, find_effect
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.in_memory import preload
from gyrocal_ros.sim.drives import TEST_DRIVES
from gyrocal_ros.sim.forward import HiddenEffect
from gyrocal_ros.sim.sensors import SensorErrors, without_noise
from gyrocal_ros.sim.varied import TILT_SCALE_STD, varied_scenario
from gyrocal_ros.sim.world import SimSource


def rough_floor(
    x_scale_error: float,
    y_scale_error: float,
    hidden: tuple[HiddenEffect, ...] = (),
    errors: SensorErrors | None = None,
) -> SimSource:
    drive = TEST_DRIVES['rough']
    tilted = replace(errors or drive.errors, x_scale_error=x_scale_error, y_scale_error=y_scale_error)
    slow = replace(drive, duration_s=100.0, imu_hz=100, camera_hz=5, errors=tilted)
    return SimSource(slow, seed=0, hidden=hidden)


def diagnosed(source: SimSource, tilt_scale_std: float) -> Diagnosis:
    config = replace(Config(), gyro=replace(Config().gyro, tilt_scale_std=tilt_scale_std))
    kept, _ = preload(source, config, default_model())
    recorded = summarise_recording(kept)
    searched = find_missing(
        default_model(), recorded, lambda model, tried: calibrate(kept, config, model, candidates=tried)
    )
    return diagnose(searched, recorded)


def test_readings_of_x_and_y_are_scaled() -> None:
    quiet = replace(without_noise(SensorErrors()), turn_on_bias_deg_s=0.0)
    exact, scaled = (
        np.array([item.rate_rad_s for item in source.measurements() if isinstance(item, ImuSample)])
        for source in (rough_floor(0.0, 0.0, errors=quiet), rough_floor(0.04, -0.02, errors=quiet))
    )
    assert np.ptp(exact, axis=0).min() > 0.1
    np.testing.assert_allclose(scaled, exact * [1.04, 0.98, 1.0], atol=1e-12)


def test_the_two_gyros_of_a_varied_robot_err_alike_in_part() -> None:
    drawn = [varied_scenario(seed).errors for seed in range(400)]
    errors = np.array([(item.x_scale_error, item.y_scale_error) for item in drawn])
    np.testing.assert_allclose(errors.std(axis=0), TILT_SCALE_STD, rtol=0.15)
    assert np.corrcoef(errors.T)[0, 1] == pytest.approx(0.5, abs=0.15)


@pytest.mark.slow
def test_sills_are_no_error_of_the_camera() -> None:
    source = rough_floor(-0.03, -0.03)
    accused = diagnosed(source, tilt_scale_std=0.0)
    assert {item.effect.name for item in accused.missing} & {'focal_length', 'radial_distortion'}
    assert diagnosed(source, Config().gyro.tilt_scale_std).verdict == 'nothing_missing'


@pytest.mark.slow
def test_a_wrong_focal_length_is_found_beside() -> None:
    hidden = (HiddenEffect(find_effect('focal_length'), (0.02,)),)
    found = diagnosed(rough_floor(0.02, 0.02, hidden), Config().gyro.tilt_scale_std)
    (missing,) = found.missing
    assert missing.effect.name == 'focal_length'
    assert missing.values[0] == pytest.approx(0.02, abs=4.0 * missing.stds[0])
