"""Tilt of a gyro by the levelled attitude."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyrocal_ros.pipeline.mount_tilt import ACCELEROMETER_STD_RAD, MountTilt, mean_tilt

TIME_S = np.arange(0.0, 120.0, 0.1)
DT_S = np.full(len(TIME_S), 0.1)


def tilted(roll_deg: float, pitch_deg: float, sway_deg: float = 0.0) -> MountTilt:
    sway = sway_deg * np.sin(2.0 * math.pi * TIME_S / 37.0)
    euler = np.radians(np.stack([roll_deg + sway, pitch_deg - sway, 40.0 * TIME_S], axis=1))
    return mean_tilt(TIME_S, DT_S, euler)


def test_the_mean_lean_is_found_whatever_the_heading() -> None:
    found = tilted(3.0, -4.0)
    assert math.degrees(found.roll_rad) == pytest.approx(3.0)
    assert math.degrees(found.pitch_rad) == pytest.approx(-4.0)
    assert math.degrees(found.angle_rad) == pytest.approx(5.0, abs=0.01)
    assert found.scale_part == pytest.approx(0.0038, rel=0.01)
    assert found.std_rad == pytest.approx(ACCELEROMETER_STD_RAD)
    assert 'leans by 5.0 +- 0.5 deg against the vertical (0.38 %' in str(found)


def test_a_robot_that_sways_is_known_less_well() -> None:
    still, swaying = tilted(3.0, -4.0), tilted(3.0, -4.0, sway_deg=10.0)
    assert swaying.std_rad > 2.0 * still.std_rad
