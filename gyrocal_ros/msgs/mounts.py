"""How camera and IMU sit on the robot body: what transforms say, else settings and gravity."""

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
"""So much of the start tells which way gravity points."""


def mount_of_settings(config: CameraConfig) -> Mount:
    """Where the camera sits by the settings."""
    R_bc = rotation_from_quaternion(*quaternion_from_yaw(math.radians(config.mount_yaw_deg)))
    return Mount(R_bc, np.array([config.mount_x_m, config.mount_y_m, config.mount_z_m]))


def mount_of_frame(links: Sequence[Transform], frame: str) -> Mount | None:
    """Where a frame sits on the body; its name may have a prefix, as in `robot1/base_link`."""
    frames = {link.parent for link in links} | {link.child for link in links}
    bodies = [name for name in sorted(frames) if name.endswith(f'/{BODY_FRAME}')]
    mounts = (find_mount(links, frame, body) for body in (BODY_FRAME, *bodies) if frame != body)
    return next((mount for mount in mounts if mount), None)


def no_camera_transform(topic: str, frame: str) -> BagIssue:
    """That the settings have to say how the camera sits."""
    return BagIssue(
        Severity.WARNING,
        'camera_mount',
        topic,
        f'no transform says how {frame or "the camera"} sits on {BODY_FRAME}; the settings do',
        'publish it on /tf_static',
    )


def imu_rotation(
    topic: str,
    frame: str,
    links: Sequence[Transform],
    force_m_s2: Array,
    turned_against: Callable[[Array], str] = lambda R_bi: '',
) -> tuple[Array, list[BagIssue]]:
    """The rotation from an IMU's axes to body axes.

    A transform says it; without one, gravity tells an IMU that is upside down or on its side.

    Args:
        topic: of the IMU.
        frame: of the IMU.
        links: the static transforms.
        force_m_s2: (3,) mean reading of its accelerometer at rest, in its own axes; zeros where unknown.
        turned_against: names who turns the other way than an IMU that is turned so (3, 3), if anybody.

    Returns:
        The rotation (3, 3), and what had to be assumed or is contradictory.
    """
    mount = mount_of_frame(links, frame)
    R_bi = mount.R_bs if mount else IDENTITY.R_bs
    force = R_bi @ force_m_s2
    if not force.any():
        return R_bi, []
    scores = 'at rest it reads ({:.1f}, {:.1f}, {:.1f}) m/s^2 where (0, 0, 9.8) is expected'.format(*force)
    mending = upright_rotation(force)
    if mending and (witness := turned_against(mending.R_bs @ R_bi)):
        mending = upright_rotation(-force)
        scores = f'{witness} turns the other way, whatever the accelerometer says'
    if mending is UPRIGHT:
        return R_bi, []
    where = f'from {BODY_FRAME} to {frame or "its frame"}'
    if mending is None or mount:
        problem = 'is tilted' if mending is None else 'contradicts its transform'
        todo = f'check its mounting and the transform {where}'
        return R_bi, [BagIssue(Severity.WARNING, 'imu_mount', topic, f'{problem}: {scores}', todo)]
    problem = 'is upside down' if mending is UPSIDE_DOWN else 'lies on its side'
    todo = f'it is turned by {mending.words} here; better publish that {where} on /tf_static'
    return mending.R_bs, [BagIssue(Severity.WARNING, 'imu_mount', topic, f'{problem}: {scores}', todo)]


def into_body_axes(R_bi: Array) -> Callable[[ImuSample], ImuSample]:
    """A function that turns the samples of an IMU into body axes; plain floats are fastest here."""
    if np.array_equal(R_bi, np.eye(3)):
        return lambda sample: sample
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R_bi.tolist()

    def turn(vector: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = vector
        return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z

    return lambda sample: ImuSample(sample.t_ns, turn(sample.rate_rad_s), turn(sample.specific_force_m_s2))
