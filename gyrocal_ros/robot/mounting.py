"""Where camera and IMU sit, as it comes to be known on a running robot."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gyrocal_ros.config.sections import CameraConfig
from gyrocal_ros.data import Array, CameraIntrinsics, ImuSample, Rig
from gyrocal_ros.msgs.issues import BagIssue
from gyrocal_ros.msgs.mounts import (
    REST_NS,
    imu_rotation,
    missing_camera_transform,
    mount_from_settings,
    mount_from_transforms,
)
from gyrocal_ros.msgs.topics import Role
from gyrocal_ros.msgs.transforms import Transform


class Mounting:
    """Gathers calibration, transforms and the first readings of the accelerometer.

    A transform counts as soon as it comes. Where none has come when the IMU has been heard for two
    seconds, settings and gravity say how the sensors sit, and that is told.

    Args:
        config: how the camera is mounted where no transform says it.
    """

    def __init__(self, config: CameraConfig) -> None:
        self.R_bi: Array | None = None
        """(3, 3) from the IMU's axes to body axes; None while it is not known."""
        self.rig: Rig | None = None
        """None while there is no calibrated camera, or nobody knows where it sits."""
        self.findings: tuple[BagIssue, ...] = ()
        """What had to be assumed, or is contradictory."""
        self._config = config
        self._camera: CameraIntrinsics | None = None
        self._camera_frame: str | None = None
        self._frame_of_info: str | None = None
        self._imu_frame: str | None = None
        self._links: dict[str, Transform] = {}
        self._first_ns: int | None = None
        self._forces: list[tuple[float, float, float]] = []
        self._has_rested = False

    def hear_links(self, links: Iterable[Transform]) -> None:
        """Take in static transforms."""
        for link in links:
            self._links[link.child] = link
        self._decide()

    def hear_camera(self, camera: CameraIntrinsics, frame: str) -> None:
        """Take in what `camera_info` says."""
        if (camera, frame) != (self._camera, self._frame_of_info):
            self._camera, self._frame_of_info = camera, frame
            self._decide()

    def hear_features(self, frame: str) -> None:
        """Take in the frame of the features."""
        if frame != self._camera_frame:
            self._camera_frame = frame
            self._decide()

    def hear_imu(self, sample: ImuSample, frame: str) -> None:
        """Take in a sample, in the IMU's own axes."""
        if frame != self._imu_frame:
            self._imu_frame = frame
            self._decide()
        if self._has_rested:
            return
        if self._first_ns is None or sample.t_ns < self._first_ns:
            self._first_ns = sample.t_ns
        if sample.t_ns <= self._first_ns + REST_NS:
            self._forces.append(sample.specific_force_m_s2)
        else:
            self._has_rested = True
            self._decide()

    def _decide(self) -> None:
        links = list(self._links.values())
        findings = [*self._decide_imu(links), *self._decide_camera(links)]
        self.findings = tuple(findings)

    def _decide_imu(self, links: list[Transform]) -> list[BagIssue]:
        if self._imu_frame is None:
            return []
        if not self._has_rested and mount_from_transforms(links, self._imu_frame) is None:
            return []
        force = np.mean(self._forces, axis=0) if self._has_rested else np.zeros(3)
        R_bi, findings = imu_rotation(Role.IMU, self._imu_frame, links, force)
        if self.R_bi is None or not np.array_equal(R_bi, self.R_bi):
            self.R_bi = R_bi
        return findings

    def _decide_camera(self, links: list[Transform]) -> list[BagIssue]:
        if self._camera is None:
            return []
        frame = self._camera_frame or self._frame_of_info or ''
        mount = mount_from_transforms(links, frame)
        if mount is None and not self._has_rested:
            return []
        findings = [] if mount else [missing_camera_transform(Role.FEATURES, frame)]
        rig = Rig(self._camera, mount or mount_from_settings(self._config))
        if self.rig is None or not _same(rig, self.rig):
            self.rig = rig
        return findings


def _same(one: Rig, other: Rig) -> bool:
    a, b = one.camera_mount, other.camera_mount
    same_mount = np.array_equal(a.R_bs, b.R_bs) and np.array_equal(a.p_bs, b.p_bs)
    return one.camera == other.camera and same_mount
