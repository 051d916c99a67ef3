"""The ceiling camera: a pinhole behind a lens of `lens.py`, in the ROS optical frame.

The paper's camera frame has x along the optical axis and (y, z) to the left and up in the image. The optical
frame used here is (x, y, z) = (-y, -z, x) in the axes of the paper.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, Mount
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.lens import by_radial_coefficients, distort, undistort

MIN_DEPTH = 1e-6
"""Smallest depth that is divided by, in the unit of the points."""


def project(camera: CameraIntrinsics, points_c: Array) -> Array:
    """Eq. (12): project points of the optical frame to raw pixels.

    Args:
        points_c: (n, 3), of any scale: only the direction matters.

    Returns:
        (n, 2) u, v; meaningless for points behind the camera (`points_c[:, 2] <= 0`).
    """
    normalised = points_c[:, :2] / np.maximum(points_c[:, 2:], MIN_DEPTH)
    return _pixels(camera, distort(camera, normalised)[0])


@compiled
def project_with_jacobian(camera: CameraIntrinsics, points_c: Array) -> tuple[Array, Array]:
    """Eq. (14): project points to raw pixels, and differentiate these with respect to the points.

    Args:
        points_c: (n, 3), of any scale.

    Returns:
        (n, 2) pixels and (n, 2, 3) derivatives.
    """
    inverse_z = 1.0 / np.maximum(points_c[:, 2], MIN_DEPTH)
    normalised = points_c[:, :2] * inverse_z[:, None]
    distorted, lens = distort(camera, normalised)
    jacobian = np.empty((len(points_c), 2, 3))
    jacobian[:, :, :2] = lens
    jacobian[:, :, 2] = -(lens @ normalised[:, :, None])[:, :, 0]
    jacobian *= np.array([[camera.fx_px], [camera.fy_px]]) * inverse_z[:, None, None]
    return _pixels(camera, distorted), jacobian


@compiled
def pixels_by_radial_coefficients(camera: CameraIntrinsics, points_c: Array) -> Array:
    """Differentiate the pixels of points (n, 3), of any scale, with respect to k1 and k2: (n, 2, 2)."""
    by_values = by_radial_coefficients(camera, points_c[:, :2] / points_c[:, 2:])
    return by_values * np.array([[camera.fx_px], [camera.fy_px]])


def bearing(camera: CameraIntrinsics, pixels: Array) -> Array:
    """Undo the lens: return the normalised coordinates (x/z, y/z) of raw pixels.

    Args:
        pixels: (n, 2) u, v.

    Returns:
        (n, 2); errors below 1e-8 where the distortion can be inverted.
    """
    return undistort(camera, (pixels - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px])


def bearing_jacobian(camera: CameraIntrinsics, normalised: Array) -> Array:
    """Return the derivative (n, 2, 2) of `bearing` with respect to the pixels, at its result (n, 2)."""
    _, lens = distort(camera, normalised)
    return np.linalg.inv(np.array([[camera.fx_px], [camera.fy_px]]) * lens)


def in_image(camera: CameraIntrinsics, pixels: Array, border_px: float = 0.0) -> np.ndarray:
    """Return which of the pixels (n, 2) are inside the image, (n,) bool."""
    u, v = pixels[:, 0], pixels[:, 1]
    right, bottom = camera.width_px - 1 - border_px, camera.height_px - 1 - border_px
    return (u >= border_px) & (u <= right) & (v >= border_px) & (v <= bottom)


def mount_from_yaw(x_m: float, y_m: float, z_m: float, yaw_deg: float) -> Mount:
    """Return the mount of a camera that looks straight up, its image x axis at `yaw_deg` in the body."""
    yaw = math.radians(yaw_deg)
    c, s = math.cos(yaw), math.sin(yaw)
    return Mount(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x_m, y_m, z_m]))


def _pixels(camera: CameraIntrinsics, normalised: Array) -> Array:
    return normalised * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
