"""The tracker in a stream: images come in, with the IMU and what the filter last expected beside them.

On the robot the filter speaks a moment after the image, in another process; so here the tracker
predicts for itself, and takes from the filter what that expected when it had seen the image before.
Recordings are followed in the very same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import (
    Array,
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    ImuSample,
    SearchRegions,
    seconds,
)
from gyrocal_ros.model.rotation import rotation_from_euler
from gyrocal_ros.vision.gyro_attitude import GyroAttitude
from gyrocal_ros.vision.search_region import ceiling_coordinates, ceiling_pixels
from gyrocal_ros.vision.tracker import Tracker

TURN_GAIN_STD, TURN_BIAS_STD_RAD_S = 0.1, 0.02
"""How far the true turn may be from the nominal one before any was seen: a fraction of it, and a rate."""
TWIST_STD_RAD = 1e-3
"""How well the turn between two images is seen."""
FLOW_STD_PX_S = 10.0
"""How much the features may move other than they did between the last two images."""
MIN_COMMON = 3
"""Features in two images that tell how the robot moved."""


@dataclass(frozen=True, slots=True, eq=False)
class _TrackedImage:
    """What was seen in one image, and from what attitude."""

    seen: FeatureObservations
    R_wc: Array
    yaw_rad: float
    """By the gyro as far as it is put right."""
    nominal_yaw_rad: float
    """By the gyro alone."""
    yaw_error_rad: float
    """By how much the first is ahead of the images, since the start."""


class GyroAidedTracker:
    """Follows features through the images of a camera that turns as an IMU says.

    By how much that is wrong, scale factor and bias of the yaw rate, it learns by itself.

    Args:
        camera: intrinsics of the images.
        R_bc: (3, 3) from the optical frame to the body.
        config: of the tracker.
        first_id: id of the first feature.
    """

    def __init__(
        self, camera: CameraIntrinsics, R_bc: Array, config: TrackerConfig, first_id: int = 0
    ) -> None:
        self.attitude = GyroAttitude()
        self.regions: SearchRegions | None = None
        """What the filter last expected."""
        self.expected: SearchRegions | None = None
        """The same, carried to the last image."""
        self._camera, self._R_bc = camera, R_bc
        self._tracker = Tracker(camera, config, first_id)
        self._last: _TrackedImage | None = None
        self._flow_1_s: Array = np.zeros(2)
        self._gain_and_bias: Array = np.array([1.0, 0.0])
        self._information = np.diag([TURN_GAIN_STD**-2.0, TURN_BIAS_STD_RAD_S**-2.0])

    def restart(self) -> None:
        """Forget attitudes and regions: the clock of the stamps has stepped."""
        self.attitude, self.regions, self._last = GyroAttitude(), None, None

    def configure(self, config: TrackerConfig) -> None:
        """Go on with other settings of the tracker."""
        self._tracker.config = config

    def add(self, sample: ImuSample) -> None:
        """Take in an IMU sample, in body axes."""
        self.attitude.add(sample)

    def track(self, frame: Frame) -> FeatureObservations:
        """Find the features in the next image.

        Raises:
            RecordingError: the image has another size than the camera.
        """
        last = self._last
        before, yaw_rad = (last.nominal_yaw_rad, last.yaw_rad) if last else (0.0, 0.0)
        euler = self.attitude.at(frame.t_ns)
        roll, pitch, nominal_yaw_rad = (0.0, 0.0, before) if euler is None else euler
        if last and euler is not None:
            turn = np.array([nominal_yaw_rad - before, seconds(frame.t_ns - last.seen.t_ns)])
            yaw_rad += float(turn @ self._gain_and_bias)
        R_wc = rotation_from_euler(np.array([roll, pitch, yaw_rad])) @ self._R_bc
        self.expected = (
            None if euler is None else self._propagated_regions(frame.t_ns, R_wc, yaw_rad, nominal_yaw_rad)
        )
        seen = self._tracker.track(frame, R_wc, self.expected)
        image = _TrackedImage(seen, R_wc, yaw_rad, nominal_yaw_rad, self._tracker.yaw_error_rad)
        if last:
            self._update_gain_and_bias(last, image)
        self._last = image
        return seen

    def _update_gain_and_bias(self, last: _TrackedImage, image: _TrackedImage) -> None:
        """See from two images how the robot drives, and by how much its gyro is wrong.

        Gain and bias are those of least squares over all turns seen (recursive, with their priors).
        """
        dt_s = seconds(image.seen.t_ns - last.seen.t_ns)
        _, before, now = np.intersect1d(last.seen.ids, image.seen.ids, return_indices=True)
        if len(now) < MIN_COMMON or dt_s <= 0.0:
            self._flow_1_s = np.zeros(2)
            return
        moved = self._to_ceiling(image, now) - self._to_ceiling(last, before)
        self._flow_1_s = np.median(moved, axis=0) / dt_s
        turn = np.array([image.nominal_yaw_rad - last.nominal_yaw_rad, dt_s]) / TWIST_STD_RAD
        missed = (image.yaw_error_rad - last.yaw_error_rad) / TWIST_STD_RAD
        self._information = self._information + np.outer(turn, turn)
        self._gain_and_bias = self._gain_and_bias - np.linalg.solve(self._information, turn * missed)

    def _to_ceiling(self, image: _TrackedImage, rows: NDArray[np.intp]) -> Array:
        return ceiling_coordinates(self._camera, image.seen.pixels[rows], image.R_wc)

    def _propagated_regions(
        self, t_ns: int, R_wc: Array, yaw_rad: float, nominal_yaw_rad: float
    ) -> SearchRegions | None:
        """The filter's last regions as they are in an image now: turned, moved, and wider."""
        regions = self.regions
        euler = self.attitude.at(regions.t_ns) if regions else None
        if regions is None or euler is None:
            return None
        dt_s = seconds(t_ns - regions.t_ns)
        turn = np.array([nominal_yaw_rad - euler[2], dt_s])
        then = np.array([euler[0], euler[1], yaw_rad - float(turn @ self._gain_and_bias)])
        ceiling = ceiling_coordinates(self._camera, regions.pixels, rotation_from_euler(then) @ self._R_bc)
        pixels = ceiling_pixels(self._camera, ceiling + dt_s * self._flow_1_s, R_wc)
        centre = np.array([self._camera.cx_px, self._camera.cy_px])
        turn_variance = float(turn @ np.linalg.solve(self._information, turn))
        variance = (FLOW_STD_PX_S * dt_s) ** 2 + turn_variance * ((pixels - centre) ** 2).sum(axis=1)
        return replace(
            regions,
            t_ns=t_ns,
            pixels=pixels,
            covariances_px2=regions.covariances_px2 + variance[:, None, None] * np.eye(2),
        )
