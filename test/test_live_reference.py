"""The live calibrator with a heading reference in place of the ceiling camera."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from live_robot import Robot, robot

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, Measurement, TruthSample, WheelSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.msgs.topics import BODY_FRAME, IMU_FRAME
from gyrocal_ros.msgs.transforms import IDENTITY, Transform
from gyrocal_ros.pipeline.by_heading import for_reference
from gyrocal_ros.pipeline.calibrate import calibrate
from gyrocal_ros.pipeline.calibration import conclude
from gyrocal_ros.pipeline.run_filter import run_filter
from gyrocal_ros.sim.references import ReferenceSource
from gyrocal_ros.sim.scenarios import find_scenario
from gyrocal_ros.sim.sensors import with_bias_walk
from gyrocal_ros.sim.world import SimSource

DURATION_S = 60.0


@cache
def source() -> ReferenceSource:
    scenario = replace(find_scenario('cleaning'), duration_s=DURATION_S, imu_hz=50)
    return ReferenceSource(SimSource(scenario, 3), 'lidar')


@cache
def driven() -> Robot:
    """Return a robot without wheel odometry and camera after a drive."""
    new = robot(heading_reference='/pf/pose')
    new.live.transforms([Transform(BODY_FRAME, IMU_FRAME, IDENTITY)])
    left_out = (TruthSample, FeatureObservations, WheelSample)
    measured: list[Measurement] = [m for m in source().measurements() if not isinstance(m, left_out)]
    new.run(measured)
    new.live.close()
    return new


@pytest.mark.slow
def test_it_calibrates_without_a_camera() -> None:
    new, truth, drawn = driven(), source().truth, source().reference
    calibration = new.live.calibration
    z = np.array(
        [
            (calibration.scale_factor - truth.scale_factor) / calibration.scale_factor_std,
            (calibration.values[0] - truth.bias_rad_s[-1, 2]) / calibration.stds[0],
        ]
    )
    assert np.abs(z).max() < 3.0
    assert calibration.scale_factor_std < 0.02
    assert new.live.filter is not None
    found = new.live.filter.reference_numbers()
    assert found['reference_time_offset_s'] == pytest.approx(drawn.offset_s, abs=0.01)
    assert found['reference_noise_deg'] == pytest.approx(math.degrees(drawn.white_rad), rel=0.7)


@pytest.mark.slow
def test_its_health_is_that_of_a_robot_without_a_camera() -> None:
    new = driven()
    _, status = new.statuses[-1]
    assert 'camera' not in status.message and 'wheel' not in status.message
    assert float(str(status.numbers['headings_hz'])) > 1.0 and not new.regions


def test_settings_for_a_reference() -> None:
    config = for_reference(Config())
    assert config.reference.estimate_noise
    assert config.convergence.scale_std == Config().convergence.heading_scale_std
    assert config.gyro == Config().gyro


WALK = 30.0
"""Random walk of the bias, relative to that of the settings."""


@pytest.mark.slow
@pytest.mark.parametrize('seed', [0, 4])
@pytest.mark.parametrize('learns', [False, True], ids=['offline', 'live'])
def test_a_bias_that_walks_more_than_the_settings_say_is_followed(seed: int, learns: bool) -> None:
    scenario = replace(find_scenario('cleaning'), duration_s=60.0, imu_hz=50)
    walk_deg_s = WALK * Config().gyro.bias_walk_deg_s
    errors = with_bias_walk(scenario.errors, walk_deg_s, bounded_s=1e5)
    walking = ReferenceSource(SimSource(replace(scenario, errors=errors), seed), 'mocap')
    if learns:
        config = for_reference(Config())
        run = run_filter(
            walking, walking.measurements(), config, default_model(), None, None, (), follows_changes=True
        )
    else:
        run = calibrate(walking, Config(), default_model(), follows_changes=True)
        assert any('the bias of the gyro walks' in event.text for event in run.events)
    calibration, truth = conclude(run), walking.truth
    assert abs(calibration.values[0] - truth.bias_rad_s[-1, 2]) < 3.0 * calibration.stds[0]
    assert calibration.stds[0] < math.radians(walk_deg_s) * math.sqrt(scenario.duration_s)
