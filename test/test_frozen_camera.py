"""Images that repeat an earlier one while the robot moves are no measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recordings import at, recording

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import FeatureObservations, Frame, ImuSample
from gyrocal_ros.effects import default_model
from gyrocal_ros.ekf.features.frozen_camera import FROZEN
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START
from gyrocal_ros.ekf.stream import SlamStream
from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker


def scale_error_of(frozen_from_s: float, frozen_to_s: float) -> tuple[float, list[str]]:
    """Return the error of the scale factor, in standard deviations, and the events."""
    consumer = SlamStream(EkfSlam(default_model(), Config(), recording().rig))
    last, events, std = None, [], 1.0
    for item in recording().measurements():
        if isinstance(item, FeatureObservations):
            if last is not None and at(frozen_from_s) < item.t_ns < at(frozen_to_s):
                item = replace(last, t_ns=item.t_ns)
            last = item
        for record in consumer.step(item):
            std = float(record.std[COEFFICIENTS_START])
            events += [record.event] if record.event else []
    error = 1.0 + consumer.slam.state.coefficients[0] - recording().truth.scale_factor
    return float(error / std), events


@pytest.mark.parametrize('frozen_s', [(20.0, 22.0), (20.0, 40.0)])
def test_a_frozen_camera_does_not_spoil_the_estimate(frozen_s: tuple[float, float]) -> None:
    error_sigma, events = scale_error_of(*frozen_s)
    assert abs(error_sigma) < 4.0
    assert events.count(FROZEN) == 1


def test_a_sound_camera_is_not_called_frozen() -> None:
    assert FROZEN not in scale_error_of(0.0, 0.0)[1]


def test_the_tracker_repeats_the_features_of_an_image_that_is_repeated() -> None:
    rig = recording().rig
    assert rig.camera is not None
    rng = np.random.default_rng(1)
    picture = rng.integers(0, 255, (rig.camera.height_px // 10, rig.camera.width_px // 10), np.uint8)
    image = np.kron(picture, np.ones((10, 10), np.uint8))
    tracker = GyroAidedTracker(rig.camera, rig.camera_mount.R_bs, Config().tracker)
    for tick in range(100):
        tracker.add(ImuSample(at(tick / 100), (0.0, 0.0, 1.0), (0.0, 0.0, 9.8)))
    first = tracker.track(Frame(at(0.1), image))
    again = tracker.track(Frame(at(0.8), image.copy()))
    assert len(first.ids) > 3
    assert again.t_ns == at(0.8)
    assert np.array_equal(again.ids, first.ids) and np.array_equal(again.pixels, first.pixels)
