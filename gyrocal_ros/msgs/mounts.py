"""Mounting of camera and IMU on the robot body: from transforms, otherwise from settings and gravity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gyrocal_ros.config.sections import CameraConfig
from gyrocal_ros.data import NS_PER_S, Array, ImuSample, Mount
from gyrocal_ros.msgs.issues import BagIssue, Severity
from gyrocal_ros.msgs.topics import BODY_FRAME
from gyrocal_ros.msgs.transforms import (
    IDENTITY,
    UPRIGHT,
    UPSIDE_DOWN,
    Transform,
    find_mount,
    quaternion_from_yaw,
    rotation_from_quaternion,
    upright_rotation,
)

REST_NS = 2 * NS_PER_S
"""Time at the start over which the accelerometer is averaged to find the direction of gravity."""


def mount_from_settings(config: CameraConfig) -> Mount:
    """Return the mount of the camera according to the settings."""
    R_bc = rotation_from_quaternion(*quaternion_from_yaw(math.radians(config.mount_yaw_deg)))
    return Mount(R_bc, np.array([config.mount_x_m, config.mount_y_m, config.mount_z_m]))


def mount_from_transforms(links: Sequence[Transform], frame: str) -> Mount | None:
    """Return the mount of a frame on the body, whose name may have a prefix as in `robot1/base_link`."""
    frames = {link.parent for link in links} | {link.child for link in links}
    bodies = [name for name in sorted(frames) if name.endswith(f'/{BODY_FRAME}')]
    mounts = (find_mount(links, frame, body) for body in (BODY_FRAME, *bodies) if frame != body)
    return next((mount for mount in mounts if mount), None)


def missing_camera_transform(topic: str, frame: str) -> BagIssue:
    """Return the issue that no transform gives the mounting of the camera, so that the settings are used."""
    return BagIssue(
        Severity.WARNING,
        'camera_mount',
        topic,
        f'no transform from {BODY_FRAME} to {frame or "the camera"}; the mounting in the settings is used',
        'publish it on /tf_static',
    )


def imu_rotation(
    topic: str,
    frame: str,
    links: Sequence[Transform],
    force_m_s2: Array,
    opposite_topic: Callable[[Array], str] = lambda R_bi: '',
) -> tuple[Array, list[BagIssue]]:
    """Return the rotation from an IMU's axes to body axes.

    The rotation is that of the static transform. If there is none, gravity reveals an IMU that is
    upside down or on its side.

    Args:
        topic: topic of the IMU.
        frame: frame of the IMU.
        links: the static transforms.
        force_m_s2: (3,) mean accelerometer reading at rest, in the IMU's own axes; zeros if unknown.
        opposite_topic: returns, for a rotation (3, 3) of the IMU, the topic whose turns are then opposite
            to those of the IMU, or an empty string.

    Returns:
        The rotation (3, 3), and an issue for what had to be assumed or is contradictory.
    """
    mount = mount_from_transforms(links, frame)
    R_bi = mount.R_bs if mount else IDENTITY.R_bs
    force = R_bi @ force_m_s2
    if not force.any():
        return R_bi, []
    reason = 'at rest it reads ({:.1f}, {:.1f}, {:.1f}) m/s^2 where (0, 0, 9.8) is expected'.format(*force)
    correction = upright_rotation(force)
    if correction and (opposite := opposite_topic(correction.R_bs @ R_bi)):
        correction = upright_rotation(-force)
        reason = f'{opposite} turns in the opposite direction, which contradicts the accelerometer'
    if correction is UPRIGHT:
        return R_bi, []
    where = f'from {BODY_FRAME} to {frame or "its frame"}'
    if correction is None or mount:
        problem = 'is tilted' if correction is None else 'contradicts its transform'
        todo = f'check its mounting and the transform {where}'
        return R_bi, [BagIssue(Severity.WARNING, 'imu_mount', topic, f'{problem}: {reason}', todo)]
    problem = 'is upside down' if correction is UPSIDE_DOWN else 'is on its side'
    todo = f'a rotation of {correction.description} is applied; publish it {where} on /tf_static'
    return correction.R_bs, [BagIssue(Severity.WARNING, 'imu_mount', topic, f'{problem}: {reason}', todo)]


def into_body_axes(R_bi: Array) -> Callable[[ImuSample], ImuSample]:
    """Return a function that rotates the samples of an IMU into body axes.

    The rotation is written out in plain floats: for single samples this is faster than NumPy.
    """
    if np.array_equal(R_bi, np.eye(3)):
        return lambda sample: sample
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R_bi.tolist()

    def rotate(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = vector
        return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z

    return lambda sample: ImuSample(
        sample.t_ns, rotate(sample.rate_rad_s), rotate(sample.specific_force_m_s2)
    )
