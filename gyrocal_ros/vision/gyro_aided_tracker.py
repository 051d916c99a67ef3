"""Feature tracking in a stream of images, aided by the IMU and by the filter's latest predictions.

On the robot the filter runs in another process and responds after the image. The tracker therefore
predicts the attitude itself and propagates the search regions that the filter predicted after the
previous image. Recordings are processed in exactly the same way.
"""

from __future__ import annotations

import math
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
from gyrocal_ros.vision.search_region import approximate_ceiling, ceiling_pixels
from gyrocal_ros.vision.tracker import Tracker

TURN_GAIN_STD, TURN_BIAS_STD_RAD_S = 0.1, 0.02
"""Prior standard deviations of the error of a nominal turn: relative, and as a rate."""
TWIST_STD_RAD = 1e-3
"""Standard deviation of the measured turn between two images, beyond the noise of the patches."""
OUTLIER_SIGMA = 2.0
"""Measured turns that are farther from the prediction count less."""
FLOW_STD_PX_S = 10.0
"""Standard deviation of the change of the image motion since the last two images."""
MIN_COMMON = 3
"""Minimum number of common features of two images for estimating the motion of the robot."""


@dataclass(frozen=True, slots=True, eq=False)
class _TrackedImage:
    """The features found in one image and the predicted attitude of the camera."""

    seen: FeatureObservations
    R_wc: Array
    yaw_rad: float
    """Yaw by the gyro, corrected by the estimated gain and bias."""
    nominal_yaw_rad: float
    """Yaw by the uncorrected gyro."""
    yaw_error_rad: float
    """Corrected yaw minus the yaw of the images, since the start."""
    yaw_error_std_rad: float
    """Its standard deviation by the noise of the patches."""
    by_flow: bool
    """True if the gyro was so wrong that the features were found by the flow of the image."""


class GyroAidedTracker:
    """Tracks features through the images of a camera whose attitude an IMU predicts.

    It estimates the scale factor and bias of the yaw rate itself.

    Args:
        camera: intrinsics of the images.
        R_bc: (3, 3) from the optical frame to the body.
        config: settings of the tracker.
        first_id: id of the first feature.
    """

    def __init__(
        self, camera: CameraIntrinsics, R_bc: Array, config: TrackerConfig, first_id: int = 0
    ) -> None:
        self.attitude = GyroAttitude()
        self.regions: SearchRegions | None = None
        """Latest search regions predicted by the filter."""
        self.expected: SearchRegions | None = None
        """The same regions, propagated to the last image."""
        self._camera, self._R_bc = camera, R_bc
        self._tracker = Tracker(camera, config, first_id)
        self._last: _TrackedImage | None = None
        self._image: NDArray[np.uint8] | None = None
        self._flow_1_s: Array = np.zeros(2)
        self._gain_and_bias: Array = np.array([1.0, 0.0])
        self._information = np.diag([TURN_GAIN_STD**-2.0, TURN_BIAS_STD_RAD_S**-2.0])

    def restart(self) -> None:
        """Discard attitudes and regions after a step of the clock of the stamps."""
        self.attitude, self.regions, self._last, self._image = GyroAttitude(), None, None, None

    def configure(self, config: TrackerConfig) -> None:
        """Apply other settings of the tracker."""
        self._tracker.config = config

    def add(self, sample: ImuSample) -> None:
        """Add an IMU sample, in body axes."""
        self.attitude.add(sample)

    def track(self, frame: Frame) -> FeatureObservations:
        """Find the features in the next image.

        An image that repeats the one before repeats its features: either nothing moved, or the camera is
        frozen, and a search for them would follow the gyro.

        Raises:
            RecordingError: the size of the image differs from that of the camera.
        """
        last = self._last
        if last and self._image is not None and np.array_equal(frame.image, self._image):
            return replace(last.seen, t_ns=frame.t_ns)
        self._image = frame.image
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
        tracker = self._tracker
        image = _TrackedImage(
            seen,
            R_wc,
            yaw_rad,
            nominal_yaw_rad,
            tracker.yaw_error_rad,
            tracker.yaw_error_std_rad,
            tracker.found_by_flow,
        )
        if last:
            self._update_gain_and_bias(last, image)
        self._last = image
        return seen

    def _update_gain_and_bias(self, last: _TrackedImage, image: _TrackedImage) -> None:
        """Estimate the image motion and the gain and bias of the gyro from two images.

        Gain and bias are recursive least-squares estimates over all turns, with their priors. A turn counts
        by the noise of the patches: a gain by faint ones would lose all features for the rest of a turn. What
        only the flow of the image showed is no error of gain or bias.
        """
        dt_s = seconds(image.seen.t_ns - last.seen.t_ns)
        _, before, now = np.intersect1d(last.seen.ids, image.seen.ids, return_indices=True)
        if len(now) < MIN_COMMON or dt_s <= 0.0:
            self._flow_1_s = np.zeros(2)
            return
        moved = self._to_ceiling(image, now) - self._to_ceiling(last, before)
        self._flow_1_s = np.median(moved, axis=0) / dt_s
        if image.by_flow:
            return
        std_rad = math.hypot(TWIST_STD_RAD, last.yaw_error_std_rad, image.yaw_error_std_rad)
        turn = np.array([image.nominal_yaw_rad - last.nominal_yaw_rad, dt_s])
        residual = image.yaw_error_rad - last.yaw_error_rad
        expected_rad = math.sqrt(std_rad**2 + turn @ np.linalg.solve(self._information, turn))
        # An outlier counts as much as a residual of `OUTLIER_SIGMA` (Huber 1964).
        std_rad *= math.sqrt(max(1.0, abs(residual) / (OUTLIER_SIGMA * expected_rad)))
        turn, residual = turn / std_rad, residual / std_rad
        self._information = self._information + np.outer(turn, turn)
        self._gain_and_bias = self._gain_and_bias - np.linalg.solve(self._information, turn * residual)

    def _to_ceiling(self, image: _TrackedImage, rows: NDArray[np.intp]) -> Array:
        return approximate_ceiling(self._camera, image.seen.pixels[rows], image.R_wc)

    def _propagated_regions(
        self, t_ns: int, R_wc: Array, yaw_rad: float, nominal_yaw_rad: float
    ) -> SearchRegions | None:
        """Return the filter's latest regions propagated to an image: rotated, shifted and enlarged."""
        regions = self.regions
        euler = self.attitude.at(regions.t_ns) if regions else None
        if regions is None or euler is None:
            return None
        dt_s = seconds(t_ns - regions.t_ns)
        turn = np.array([nominal_yaw_rad - euler[2], dt_s])
        then = np.array([euler[0], euler[1], yaw_rad - float(turn @ self._gain_and_bias)])
        ceiling = approximate_ceiling(self._camera, regions.pixels, rotation_from_euler(then) @ self._R_bc)
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
