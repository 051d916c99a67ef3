"""The listener of the studio: outputs of a calibrator arrive as plain values."""

from __future__ import annotations

import time

import numpy as np
from graph import Graph
from rosidl_runtime_py.utilities import get_message
from sensor_msgs.msg import Image

from gyrocal_ros.msgs import images, to_ros
from gyrocal_ros.nodes.listener import listening
from gyrocal_ros.robot.feed import Overview
from gyrocal_ros.robot.health import Level


def test_calibration_health_and_tracks_are_received() -> None:
    with Graph() as graph, listening(domain=graph.domain) as feed:
        graph.start('calibrator')
        tracks = graph.publisher(Image, 'ceiling_camera/tracks_image', 1)

        def both() -> Overview | None:
            now = feed.overview(time.monotonic())
            return now if len(now.time_s) and now.nodes else None

        overview = graph.wait(both, 'the calibration and the health')
        assert overview is not None
        assert overview.scale_factor[-1] == 1.0 and overview.scale_factor_std[-1] > 0.01
        assert overview.calibration['gyro.converged'] is False
        assert overview.calibration['gyro.coefficient_names'] == ['scale_factor']
        (calibrator,) = overview.nodes
        assert calibrator.name == 'calibrator' and calibrator.level is Level.ERROR
        assert 'no message yet' in calibrator.message and 'imu_hz' in calibrator.numbers

        grey = np.zeros((48, 64, 3), np.uint8)
        tracks.publish(images.colour_image(to_ros.live_maker(get_message), 0, 'camera', grey))
        jpeg = graph.wait(lambda: feed.overview(time.monotonic()).tracks, 'the image')
        assert jpeg is not None and jpeg.startswith(b'\xff\xd8'), 'a JPEG'


def test_a_namespace_separates_two_robots() -> None:
    with Graph() as graph, listening('other', graph.domain) as other, listening('one', graph.domain) as one:
        graph.start('calibrator', namespace='one')
        graph.wait(lambda: len(one.overview(time.monotonic()).time_s), 'the calibration of one')
        assert not len(other.overview(time.monotonic()).time_s)
