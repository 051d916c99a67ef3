"""The filter with eyes: images are measurements like any other."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gyrocal_ros.data import ClockStep, FeatureObservations, Frame, ImuSample, Measurement
from gyrocal_ros.ekf.slam import EkfSlam, StepRecord
from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker


class VisualSlam:
    """The filter with the tracker before it, as the nodes of these names work together on a robot.

    Args:
        slam: the filter; its rig has a camera where images come.
        keep: told of the features seen in each image.
    """

    def __init__(
        self, slam: EkfSlam, keep: Callable[[FeatureObservations], None] = lambda seen: None
    ) -> None:
        self._slam, self._keep = slam, keep
        self._follower: GyroAidedTracker | None = None
        self._waiting: deque[Frame] = deque()

    def step(self, measurement: Measurement) -> list[StepRecord]:
        """Take one measurement, as `EkfSlam.step` does; an image waits until the IMU has reached it.

        Raises:
            FilterDivergedError: the measurements contradict the estimate beyond repair.
            RecordingError: an image has another size than the camera.
        """
        if isinstance(measurement, Frame):
            self._follower = self._follower or self._first_follower()
            self._waiting.append(measurement)
            return []
        records: list[StepRecord] = []
        if self._follower and isinstance(measurement, ImuSample):
            self._follower.add(measurement)
            while self._waiting and self._waiting[0].t_ns <= measurement.t_ns:
                records += self._look(self._follower)
        elif self._follower and isinstance(measurement, ClockStep):
            records += self._look_at_all()
            self._follower.restart()
        return records + self._step(measurement)

    def finish(self) -> list[StepRecord]:
        """Use what still waits, at the end of the stream."""
        return [*self._look_at_all(), *self._slam.finish()]

    def _first_follower(self) -> GyroAidedTracker:
        rig, config = self._slam.rig, self._slam.config
        assert rig.camera is not None
        self._slam.expect_pixel_noise(config.tracker.noise_px)
        return GyroAidedTracker(rig.camera, rig.camera_mount.R_bs, config.tracker)

    def _look_at_all(self) -> list[StepRecord]:
        records: list[StepRecord] = []
        while self._follower and self._waiting:
            records += self._look(self._follower)
        return records

    def _look(self, follower: GyroAidedTracker) -> list[StepRecord]:
        """Follow the features through the image that has waited longest."""
        seen = follower.track(self._waiting.popleft())
        self._keep(seen)
        return self._step(seen)

    def _step(self, measurement: Measurement) -> list[StepRecord]:
        records = self._slam.step(measurement)
        if records and self._follower:
            self._follower.regions = self._slam.regions()
        return records
