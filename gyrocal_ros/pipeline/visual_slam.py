"""The filter with the feature tracker in front of it: images are measurements like any other."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from gyrocal_ros.data import ClockStep, FeatureObservations, Frame, ImuSample, Measurement
from gyrocal_ros.ekf.history.step_record import StepRecord
from gyrocal_ros.ekf.slam import EkfSlam
from gyrocal_ros.ekf.stream import SlamStream

if TYPE_CHECKING:
    from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker


class VisualSlam:
    """Filter and tracker, connected as the nodes of these names are on a robot.

    Args:
        slam: the filter; its rig has a camera if there are images.
        keep: called with the features observed in each image.
    """

    def __init__(
        self, slam: EkfSlam, keep: Callable[[FeatureObservations], None] = lambda observed: None
    ) -> None:
        self._slam, self._stream, self._keep = slam, SlamStream(slam), keep
        self._tracker: GyroAidedTracker | None = None
        self._waiting: deque[Frame] = deque()

    def step(self, measurement: Measurement) -> list[StepRecord]:
        """Take one measurement, as `SlamStream.step` does; an image waits until the IMU has reached it.

        Raises:
            FilterDivergedError: the measurements contradict the estimate beyond repair.
            RecordingError: an image has another size than the camera.
        """
        if isinstance(measurement, Frame):
            self._tracker = self._tracker or self._first_tracker()
            self._waiting.append(measurement)
            return []
        if self._tracker is None:
            return self._stream.step(measurement)
        records: list[StepRecord] = []
        if isinstance(measurement, ImuSample):
            self._tracker.add(measurement)
            while self._waiting and self._waiting[0].t_ns <= measurement.t_ns:
                records += self._track(self._tracker)
        elif isinstance(measurement, ClockStep):
            records += self._track_all()
            self._tracker.restart()
        return records + self._step(measurement)

    def replace_filter(self, slam: EkfSlam) -> None:
        """Go on with a filter that knows nothing yet; the tracker keeps its features and their numbers."""
        self._slam, self._stream = slam, SlamStream(slam)
        slam.expect_pixel_noise(slam.config.tracker.noise_px)

    def finish(self) -> list[StepRecord]:
        """Use the images that still wait, at the end of the stream."""
        return [*self._track_all(), *self._stream.finish()]

    def _first_tracker(self) -> GyroAidedTracker:
        from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker  # OpenCV is loaded only for images

        rig, config = self._slam.rig, self._slam.config
        assert rig.camera is not None
        self._slam.expect_pixel_noise(config.tracker.noise_px)
        return GyroAidedTracker(rig.camera, rig.camera_mount.R_bs, config.tracker)

    def _track_all(self) -> list[StepRecord]:
        records: list[StepRecord] = []
        while self._tracker and self._waiting:
            records += self._track(self._tracker)
        return records

    def _track(self, tracker: GyroAidedTracker) -> list[StepRecord]:
        """Track the features through the image that has waited longest."""
        observed = tracker.track(self._waiting.popleft())
        self._keep(observed)
        return self._step(observed)

    def _step(self, measurement: Measurement) -> list[StepRecord]:
        records = self._stream.step(measurement)
        if records and self._tracker:
            self._tracker.regions = self._slam.regions()
        return records
