"""Mounting of camera and IMU on a running robot, from transforms, camera_info and gravity."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gyrocal_ros.config.sections import CameraConfig
from gyrocal_ros.data import NS_PER_S, Array, CameraIntrinsics, ImuSample, Rig
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

OTHER_NS = NS_PER_S
"""Time for which a frame of the IMU has to be away until another one takes its place."""
ANOTHER_IMU = 'it is of another IMU on the same topic, with another frame_id'


class Mounting:
    """Determines the mounting of the sensors from camera_info, transforms and the first IMU samples.

    A transform is used as soon as it arrives. Without one, two seconds after the first IMU sample, the
    mounting of the camera is taken from the settings and that of the IMU from gravity, with an issue that
    says so.

    Args:
        config: mounting of the camera without a transform.
        has_camera: False if there is another heading reference; then only the IMU is mounted.
    """

    def __init__(self, config: CameraConfig, *, has_camera: bool = True) -> None:
        self.R_bi: Array | None = None
        """(3, 3) from the IMU's axes to body axes; None while unknown."""
        self.rig: Rig | None = None
        """Camera and its mounting; None while one of them is unknown."""
        self.issues: tuple[BagIssue, ...] = ()
        """Assumptions that were needed, and contradictions."""
        self._config, self._has_camera = config, has_camera
        self._camera: CameraIntrinsics | None = None
        self._camera_frame: str | None = None
        self._info_frame: str | None = None
        self._imu_frame: str | None = None
        self._imu_ns = 0
        self._transforms: dict[str, Transform] = {}
        self._first_ns: int | None = None
        self._forces_m_s2: list[tuple[float, float, float]] = []
        self._has_gravity = False

    def add_transforms(self, transforms: Iterable[Transform]) -> None:
        """Take in static transforms."""
        for transform in transforms:
            self._transforms[transform.child] = transform
        self._update()

    def set_camera(self, camera: CameraIntrinsics, frame: str) -> None:
        """Set the intrinsics, and the frame of `camera_info`."""
        if (camera, frame) != (self._camera, self._info_frame):
            self._camera, self._info_frame = camera, frame
            self._update()

    def set_camera_frame(self, frame: str) -> None:
        """Set the frame of the features."""
        if frame != self._camera_frame:
            self._camera_frame = frame
            self._update()

    def add_imu(self, sample: ImuSample, frame: str) -> bool:
        """Take in a sample in the IMU's own axes; return False for one of another IMU on the same topic.

        A frame takes the place of one that has not been seen for a second, as of a driver that was restarted.
        """
        if frame != self._imu_frame:
            if self._imu_frame is not None and abs(sample.t_ns - self._imu_ns) < OTHER_NS:
                return False
            self._imu_frame = frame
            self._update()
        self._imu_ns = sample.t_ns
        self._add_gravity(sample)
        return True

    def _add_gravity(self, sample: ImuSample) -> None:
        if self._has_gravity:
            return
        if self._first_ns is None or sample.t_ns < self._first_ns:
            self._first_ns = sample.t_ns
        if sample.t_ns <= self._first_ns + REST_NS:
            self._forces_m_s2.append(sample.specific_force_m_s2)
        else:
            self._has_gravity = True
            self._update()

    def _update(self) -> None:
        transforms = list(self._transforms.values())
        self.issues = (*self._update_imu(transforms), *self._update_camera(transforms))
        if not self._has_camera and self.R_bi is not None and self.rig is None:
            self.rig = Rig(None, mount_from_settings(self._config))

    def _update_imu(self, transforms: list[Transform]) -> list[BagIssue]:
        if self._imu_frame is None:
            return []
        if not self._has_gravity and mount_from_transforms(transforms, self._imu_frame) is None:
            return []
        force_m_s2 = np.mean(self._forces_m_s2, axis=0) if self._has_gravity else np.zeros(3)
        R_bi, issues = imu_rotation(Role.IMU, self._imu_frame, transforms, force_m_s2)
        if self.R_bi is None or not np.array_equal(R_bi, self.R_bi):
            self.R_bi = R_bi
        return issues

    def _update_camera(self, transforms: list[Transform]) -> list[BagIssue]:
        if self._camera is None or not self._has_camera:
            return []
        frame = self._camera_frame or self._info_frame or ''
        mount = mount_from_transforms(transforms, frame)
        if mount is None and not self._has_gravity:
            return []
        issues = [] if mount else [missing_camera_transform(Role.FEATURES, frame)]
        rig = Rig(self._camera, mount or mount_from_settings(self._config))
        if self.rig is None or not _is_same(rig, self.rig):
            self.rig = rig
        return issues


def _is_same(one: Rig, other: Rig) -> bool:
    a, b = one.camera_mount, other.camera_mount
    same_mount = np.array_equal(a.R_bs, b.R_bs) and np.array_equal(a.p_bs, b.p_bs)
    return one.camera == other.camera and same_mount
