"""The tracker on a running robot: images, IMU and search regions come as they may, features go out."""

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
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform
from gyrocal_ros.robot.health import Status
from gyrocal_ros.robot.mounting import Mounting
from gyrocal_ros.robot.tracking_health import TrackingHealth
from gyrocal_ros.vision.draw import draw_tracks
from gyrocal_ros.vision.gyro_aided_tracker import GyroAidedTracker
from gyrocal_ros.vision.tracker import ID_COUNT

MAX_WAITING = 3
"""Images that wait at most; the oldest go first."""
LEAP_NS = NS_PER_S // 2
"""Stamps that go back by more are of a clock that was set; by less, of a message that came late."""
SILENT_S = 1.0
"""An IMU or a filter that has said nothing for so long is not waited for."""
UNMOUNTED_S = 3.0
"""Where neither a transform nor the IMU has come for so long, the settings say how the camera sits."""
NS_PER_ID = 2**20
"""A tracker begins to count its features where none before it can have come to: they need less than one
id in so long. The filter would take a feature for another of the same id. All begins again in 52 days."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """An image, and what was seen in it."""

    frame: Frame
    seen: FeatureObservations
    expected: SearchRegions | None
    """Where the filter's features were looked for."""
    came_s: float
    """When the image came."""

    def picture(self) -> NDArray[np.uint8]:
        """The image with tracks and search regions drawn in, (height, width, 3) blue, green, red."""
        return draw_tracks(self.frame.image, self.seen, self.expected)


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    frame: Frame
    came_s: float


class LiveTracker:
    """Follows the features of the ceiling while the robot drives.

    An image waits a moment for the IMU to reach its stamp, and for what the filter says of the image
    before; it is followed without either where they do not come. After each call that takes something
    in, call `work` until it has nothing left.

    Args:
        config: of the tracker.
        camera: how the camera is mounted where no transform says it.
        patience_s: how long an image waits.
        now_s: the time by a clock that is never set, as everywhere here.
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
        self._turn = into_body_axes(self._R_bi)
        self._waiting: deque[_Waiting] = deque()
        self._last_ns: int | None = None
        self._due_regions_ns = 0
        self._imu_s = self._regions_s = -np.inf

    # --- what comes in ---------------------------------------------------------------------------

    def image(self, frame: Frame, frame_id: str, now_s: float) -> None:
        """Take an image; one that is not newer than the last is left out."""
        self.health.hear_image(frame.t_ns, now_s)
        self._mounting.hear_features(frame_id)
        newest_ns = self._waiting[-1].frame.t_ns if self._waiting else self._last_ns
        if newest_ns is not None and frame.t_ns <= newest_ns:
            if newest_ns - frame.t_ns < LEAP_NS:
                self.health.late()
                return
            self._start_anew('the stamps of the images went back', now_s)
        self._waiting.append(_Waiting(frame, now_s))
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popleft()
            self.health.drop()

    def imu(self, sample: ImuSample, frame_id: str, now_s: float) -> None:
        """Take a sample in the IMU's own axes."""
        self._imu_s = now_s
        self._mounting.hear_imu(sample, frame_id)
        R_bi = self._mounting.R_bi
        if R_bi is not None and R_bi is not self._R_bi:
            self._R_bi, self._turn = R_bi, into_body_axes(R_bi)
        self.health.hear_imu(sample.t_ns, now_s)
        if self._follower is None:
            return
        until_ns = self._follower.attitude.until_ns
        if until_ns is not None and sample.t_ns < until_ns - LEAP_NS:
            self._start_anew('the stamps of the IMU went back', now_s)
        self._follower.add(self._turn(sample))

    def regions(self, regions: SearchRegions, now_s: float) -> None:
        """Take what the filter expects."""
        self._regions_s = now_s
        follower = self._follower
        if follower is not None and (follower.regions is None or regions.t_ns >= follower.regions.t_ns):
            follower.regions = regions

    def camera(self, camera: CameraIntrinsics, frame_id: str, now_s: float) -> None:
        """Take what `camera_info` says."""
        if self._intrinsics is None:
            self._camera_s = now_s
        self.health.hear(Role.CAMERA_INFO, now_s)
        self._intrinsics = camera
        self._mounting.hear_camera(camera, frame_id)

    def links(self, links: Iterable[Transform]) -> None:
        """Take static transforms."""
        self._mounting.hear_links(links)

    def configure(self, config: TrackerConfig, patience_s: float) -> None:
        """Go on with other settings; of those that need a new start, nothing is heard."""
        self._config, self._patience_s = config, patience_s
        if self._follower is not None:
            self._follower.configure(config)

    # --- what goes out ---------------------------------------------------------------------------

    @property
    def is_waiting(self) -> bool:
        """Whether there is an image that `work` will follow when its time has come."""
        return bool(self._waiting)

    def work(self, now_s: float) -> Tracked | None:
        """Follow the features through the image that has waited longest, if its time has come."""
        while self._waiting and self._is_due(self._waiting[0], now_s):
            waiting = self._waiting.popleft()
            follower = self._follower_for(waiting.frame, now_s)
            if follower is None:
                continue
            try:
                seen = follower.track(waiting.frame)
            except RecordingError as error:
                self.health.spoil(f'{error.what}; {error.todo}')
                continue
            t_ns = seen.t_ns
            last_ns = t_ns if self._last_ns is None else self._last_ns
            self._last_ns, self._due_regions_ns = t_ns, (last_ns + t_ns) // 2  # the filter's clock may be off
            self.health.see(waiting.frame, seen, follower.expected is not None, now_s)
            return Tracked(waiting.frame, seen, follower.expected, waiting.came_s)
        return None

    def status(self, now_s: float) -> Status:
        """How it is; to be asked once a second or so."""
        findings = tuple(str(finding) for finding in self._mounting.findings)
        return self.health.tell(knows_camera=self._intrinsics is not None, standing=findings, now_s=now_s)

    # --- how -------------------------------------------------------------------------------------

    def _is_due(self, waiting: _Waiting, now_s: float) -> bool:
        if now_s - waiting.came_s >= self._patience_s or self._follower is None:
            return True
        until_ns, regions = self._follower.attitude.until_ns, self._follower.regions
        is_turned = until_ns is not None and until_ns >= waiting.frame.t_ns
        is_guided = regions is not None and regions.t_ns >= self._due_regions_ns
        imu_is_silent, filter_is_silent = now_s - self._imu_s > SILENT_S, now_s - self._regions_s > SILENT_S
        return (is_turned or imu_is_silent) and (is_guided or filter_is_silent)

    def _follower_for(self, frame: Frame, now_s: float) -> GyroAidedTracker | None:
        """Who follows now; None while the camera is not known."""
        rig = self._mounting.rig
        if rig is None and self._intrinsics is not None and now_s - self._camera_s > UNMOUNTED_S:
            rig = self._rig or Rig(self._intrinsics, mount_from_settings(self._camera_config))
        if rig is not None and rig is not self._rig:
            assert rig.camera is not None
            first_id = frame.t_ns // NS_PER_ID % ID_COUNT
            self._rig = rig
            self._follower = GyroAidedTracker(rig.camera, rig.camera_mount.R_bs, self._config, first_id)
        return self._follower

    def _start_anew(self, why: str, now_s: float) -> None:
        """Go on in another time base."""
        self.health.happened(f'{why}: a clock was set; attitudes and search regions are begun anew', now_s)
        self._waiting.clear()
        self._last_ns, self._due_regions_ns = None, 0
        if self._follower is not None:
            self._follower.restart()
