"""The tracker on a running robot: images, IMU samples and search regions go in, features come out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import CameraConfig, TrackerConfig
from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CameraIntrinsics,
    FeatureObservations,
    Frame,
    ImuSample,
    Rig,
    SearchRegions,
)
from gyrocal_ros.errors import RecordingError
from gyrocal_ros.msgs.mounts import into_body_axes, mount_from_settings
from gyrocal_ros.msgs.plausible import IMPLAUSIBLE, IMU_BOUNDS, plausible
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform
from gyrocal_ros.robot.health import Status, TrackingHealth
from gyrocal_ros.robot.mounting import ANOTHER_IMU, Mounting
from gyrocal_ros.vision.draw import draw_tracks
from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker
from gyrocal_ros.vision.tracker import ID_COUNT

MAX_WAITING = 3
"""Queue limit of the images; the oldest are dropped first."""
CLOCK_STEP_NS = NS_PER_S // 2
"""Smallest backward jump of the stamps that is a clock step; a smaller one is a late message."""
SILENT_S = 1.0
"""Time without a message after which the images no longer wait for the IMU, or for the filter."""
UNMOUNTED_S = 3.0
"""Time after `camera_info`, without a transform and without the IMU, from which the mounting of the settings
is used."""
NS_PER_ID = 2**20
"""Time (ns) for one feature id: the first id of a tracker is its first stamp divided by this. A tracker uses
fewer ids than that, so a restarted one repeats none, which the filter would match. Ids wrap after 52 days."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """An image and the features seen in it."""

    frame: Frame
    seen: FeatureObservations
    expected: SearchRegions | None
    """Search regions that were used."""
    arrival_s: float
    """Arrival of the image."""

    def picture(self) -> NDArray[np.uint8]:
        """Return the image with tracks and search regions, (height, width, 3) in blue, green, red."""
        return draw_tracks(self.frame.image, self.seen, self.expected)


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    frame: Frame
    arrival_s: float


class LiveTracker:
    """Tracks the features of the ceiling while the robot drives.

    An image waits for the IMU to reach its stamp and for the search regions of the image before; after a
    timeout it is tracked without them. After each call that takes in a message, call `work` until it has
    nothing left.

    Args:
        config: settings of the tracker.
        camera: mounting of the camera without a transform.
        patience_s: timeout of an image.
        now_s: the present time by a monotonic clock, as are all times `now_s` here.
    """

    def __init__(self, config: TrackerConfig, camera: CameraConfig, patience_s: float, now_s: float) -> None:
        self.health = TrackingHealth(now_s)
        self._config, self._camera_config, self._patience_s = config, camera, patience_s
        self._mounting = Mounting(camera)
        self._intrinsics: CameraIntrinsics | None = None
        self._camera_s = now_s
        self._follower: GyroAidedTracker | None = None
        self._rig: Rig | None = None
        self._R_bi: Array = np.eye(3)
        self._to_body = into_body_axes(self._R_bi)
        self._waiting: deque[_Waiting] = deque()
        self._last_ns: int | None = None
        self._due_regions_ns = 0
        self._imu_s = self._regions_s = -np.inf

    # --- input ------------------------------------------------------------------------------------

    def image(self, frame: Frame, frame_id: str, now_s: float) -> None:
        """Take in an image; one that is not newer than the last is dropped."""
        self.health.add_image(frame.t_ns, now_s)
        self._mounting.set_camera_frame(frame_id)
        newest_ns = self._waiting[-1].frame.t_ns if self._waiting else self._last_ns
        if newest_ns is not None and frame.t_ns <= newest_ns:
            if newest_ns - frame.t_ns < CLOCK_STEP_NS:
                self.health.log.counts['late'] += 1
                return
            self._restart('the stamps of the images went back', now_s)
        self._waiting.append(_Waiting(frame, now_s))
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popleft()
            self.health.log.counts['dropped'] += 1

    def imu(self, sample: ImuSample, frame_id: str, now_s: float) -> None:
        """Take in a sample in the IMU's own axes."""
        if not plausible((*sample.rate_rad_s, *sample.specific_force_m_s2), IMU_BOUNDS):
            self.health.log.add_unusable(Role.IMU, IMPLAUSIBLE)
            return
        if not self._mounting.add_imu(sample, frame_id):
            self.health.log.add_unusable(Role.IMU, ANOTHER_IMU)
            return
        self._imu_s = now_s
        R_bi = self._mounting.R_bi
        if R_bi is not None and R_bi is not self._R_bi:
            self._R_bi, self._to_body = R_bi, into_body_axes(R_bi)
        self.health.add_imu(sample.t_ns, now_s)
        if self._follower is None:
            return
        until_ns = self._follower.attitude.until_ns
        if until_ns is not None and sample.t_ns < until_ns - CLOCK_STEP_NS:
            self._restart('the stamps of the IMU went back', now_s)
        self._follower.add(self._to_body(sample))

    def regions(self, regions: SearchRegions, now_s: float) -> None:
        """Take in the search regions of the filter."""
        self._regions_s = now_s
        follower = self._follower
        if follower is not None and (follower.regions is None or regions.t_ns >= follower.regions.t_ns):
            follower.regions = regions

    def camera(self, camera: CameraIntrinsics, frame_id: str, now_s: float) -> None:
        """Take in the intrinsics of `camera_info`."""
        if self._intrinsics is None:
            self._camera_s = now_s
        self.health.log.add_arrival(Role.CAMERA_INFO, now_s)
        self._intrinsics = camera
        self._mounting.set_camera(camera, frame_id)

    def transforms(self, transforms: Iterable[Transform]) -> None:
        """Take in static transforms."""
        self._mounting.add_transforms(transforms)

    def configure(self, config: TrackerConfig, patience_s: float) -> None:
        """Replace the settings; those that are only read at the start have no effect."""
        self._config, self._patience_s = config, patience_s
        if self._follower is not None:
            self._follower.configure(config)

    # --- output -----------------------------------------------------------------------------------

    @property
    def is_waiting(self) -> bool:
        """True if an image waits for the IMU or for search regions."""
        return bool(self._waiting)

    def work(self, now_s: float) -> Tracked | None:
        """Track the features in the oldest image, if that need not wait any longer."""
        while self._waiting and self._is_due(self._waiting[0], now_s):
            waiting = self._waiting.popleft()
            follower = self._follower_for(waiting.frame, now_s)
            if follower is None:
                continue
            try:
                seen = follower.track(waiting.frame)
            except RecordingError as error:
                self.health.log.add_unusable(Role.IMAGE, f'{error.what}; {error.todo}')
                continue
            t_ns = seen.t_ns
            last_ns = t_ns if self._last_ns is None else self._last_ns
            # The stamp of the regions differs from that of the image by the estimated camera time offset.
            self._last_ns, self._due_regions_ns = t_ns, (last_ns + t_ns) // 2
            self.health.add_tracked(waiting.frame, seen, follower.expected is not None, now_s)
            return Tracked(waiting.frame, seen, follower.expected, waiting.arrival_s)
        return None

    def status(self, now_s: float) -> Status:
        """Return the present health; call it about once a second."""
        issues = [str(issue) for issue in self._mounting.issues]
        return self.health.status(self._intrinsics is not None, issues, now_s)

    # --- internals --------------------------------------------------------------------------------

    def _is_due(self, waiting: _Waiting, now_s: float) -> bool:
        if now_s - waiting.arrival_s >= self._patience_s or self._follower is None:
            return True
        until_ns, regions = self._follower.attitude.until_ns, self._follower.regions
        has_imu = until_ns is not None and until_ns >= waiting.frame.t_ns
        has_regions = regions is not None and regions.t_ns >= self._due_regions_ns
        imu_is_silent, filter_is_silent = now_s - self._imu_s > SILENT_S, now_s - self._regions_s > SILENT_S
        return (has_imu or imu_is_silent) and (has_regions or filter_is_silent)

    def _follower_for(self, frame: Frame, now_s: float) -> GyroAidedTracker | None:
        """Return the follower for the present camera and mounting; None while they are unknown."""
        rig = self._mounting.rig
        if rig is None and self._intrinsics is not None and now_s - self._camera_s > UNMOUNTED_S:
            rig = self._rig or Rig(self._intrinsics, mount_from_settings(self._camera_config))
        if rig is not None and rig is not self._rig:
            assert rig.camera is not None
            first_id = frame.t_ns // NS_PER_ID % ID_COUNT
            self._rig = rig
            self._follower = GyroAidedTracker(rig.camera, rig.camera_mount.R_bs, self._config, first_id)
        return self._follower

    def _restart(self, why: str, now_s: float) -> None:
        """Continue with stamps of another time base."""
        self.health.log.add_event(f'{why}: a clock was set; attitudes and search regions are reset', now_s)
        self._waiting.clear()
        self._last_ns, self._due_regions_ns = None, 0
        if self._follower is not None:
            self._follower.restart()
