"""The tracker in a stream: images come in, with the IMU and what the filter last expected beside them.

On the robot the filter speaks a moment after the image, in another process; so here the tracker
predicts for itself, and takes from the filter what that expected when it had seen the image before.
Recordings are followed in the very same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config import TrackerConfig
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
from gyrocal_ros.vision.search import ceiling_coordinates, ceiling_pixels
from gyrocal_ros.vision.tracker import Tracker
from gyrocal_ros.vision.turning import Turning

TURN_GAIN_STD = 0.1
"""How far the true turn may be from the nominal one, as a fraction of it, before any was seen."""
TWIST_NOISE_RAD = 1e-3
"""How well the turn between two images is seen."""
FLOW_DOUBT_PX_S = 10.0
"""How much the features may move other than they did between the last two images."""
MIN_COMMON = 3
"""Features in two images that tell how the robot moved."""


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What was seen in one image, and from what attitude."""

    seen: FeatureObservations
    R_wc: Array
    yaw_rad: float
    """By the gyro as far as it is put right."""
    nominal_yaw_rad: float
    """By the gyro alone."""
    yaw_error_rad: float
    """By how much the first is ahead of the images, since the start."""


class Follower:
    """Follows features through the images of a camera that turns as an IMU says.

    Args:
        camera: intrinsics of the images.
        R_bc: (3, 3) from the optical frame to the body.
        config: of the tracker.
        first_id: id of the first feature.
    """

    def __init__(
        self, camera: CameraIntrinsics, R_bc: Array, config: TrackerConfig, first_id: int = 0
    ) -> None:
        self.turning = Turning()
        self.regions: SearchRegions | None = None
        """What the filter last expected."""
        self.expected: SearchRegions | None = None
        """The same, carried to the last image."""
        self._camera, self._R_bc = camera, R_bc
        self._tracker = Tracker(camera, config, first_id)
        self._last: _Look | None = None
        self._flow_1_s: Array = np.zeros(2)
        self._gain = 1.0
        self._turns_seen = (TWIST_NOISE_RAD / TURN_GAIN_STD) ** 2

    def start_anew(self) -> None:
        """Forget attitudes and regions: the clock of the stamps has stepped."""
        self.turning, self.regions, self._last = Turning(), None, None

    def configure(self, config: TrackerConfig) -> None:
        """Go on with other settings of the tracker."""
        self._tracker.config = config

    def add(self, sample: ImuSample) -> None:
        """Take in an IMU sample, in body axes."""
        self.turning.add(sample)

    def track(self, frame: Frame) -> FeatureObservations:
        """Find the features in the next image.

        Raises:
            RecordingError: the image has another size than the camera.
        """
        last = self._last
        before, yaw_rad = (last.nominal_yaw_rad, last.yaw_rad) if last else (0.0, 0.0)
        euler = self.turning.at(frame.t_ns)
        roll, pitch, nominal_yaw_rad = (0.0, 0.0, before) if euler is None else euler
        yaw_rad += self._gain * (nominal_yaw_rad - before) if last else 0.0
        R_wc = rotation_from_euler(np.array([roll, pitch, yaw_rad])) @ self._R_bc
        self.expected = None if euler is None else self._carried(frame.t_ns, R_wc, yaw_rad, nominal_yaw_rad)
        seen = self._tracker.track(frame, R_wc, self.expected)
        look = _Look(seen, R_wc, yaw_rad, nominal_yaw_rad, self._tracker.yaw_error_rad)
        if last:
            self._learn(last, look)
        self._last = look
        return seen

    def _learn(self, last: _Look, look: _Look) -> None:
        """See from two images how the robot drives, and by how much its gyro overstates a turn."""
        dt_s = seconds(look.seen.t_ns - last.seen.t_ns)
        _, before, now = np.intersect1d(last.seen.ids, look.seen.ids, return_indices=True)
        if len(now) < MIN_COMMON or dt_s <= 0.0:
            self._flow_1_s = np.zeros(2)
            return
        moved = self._to_ceiling(look, now) - self._to_ceiling(last, before)
        self._flow_1_s = np.median(moved, axis=0) / dt_s
        turn_rad = look.nominal_yaw_rad - last.nominal_yaw_rad
        missed_rad = look.yaw_error_rad - last.yaw_error_rad
        self._turns_seen += turn_rad**2
        self._gain -= turn_rad * missed_rad / self._turns_seen

    def _to_ceiling(self, look: _Look, rows: NDArray[np.intp]) -> Array:
        return ceiling_coordinates(self._camera, look.seen.pixels[rows], look.R_wc)

    def _carried(
        self, t_ns: int, R_wc: Array, yaw_rad: float, nominal_yaw_rad: float
    ) -> SearchRegions | None:
        """The filter's last regions as they are in an image now: turned, moved, and wider."""
        regions = self.regions
        euler = self.turning.at(regions.t_ns) if regions else None
        if regions is None or euler is None:
            return None
        turned_rad = self._gain * (nominal_yaw_rad - euler[2])
        then = np.array([euler[0], euler[1], yaw_rad - turned_rad])
        dt_s = seconds(t_ns - regions.t_ns)
        ceiling = ceiling_coordinates(self._camera, regions.pixels, rotation_from_euler(then) @ self._R_bc)
        pixels = ceiling_pixels(self._camera, ceiling + dt_s * self._flow_1_s, R_wc)
        centre = np.array([self._camera.cx_px, self._camera.cy_px])
        turn_std = TWIST_NOISE_RAD / math.sqrt(self._turns_seen) * abs(nominal_yaw_rad - euler[2])
        radius_px = np.linalg.norm(pixels - centre, axis=1)
        variance = (FLOW_DOUBT_PX_S * dt_s) ** 2 + (turn_std * radius_px) ** 2
        return replace(
            regions,
            t_ns=t_ns,
            pixels=pixels,
            covariances_px2=regions.covariances_px2 + variance[:, None, None] * np.eye(2),
        )
