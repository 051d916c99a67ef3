"""The ceiling camera: pinhole with `plumb_bob` distortion, in the ROS optical frame.

The paper's camera frame has x along the optical axis and (y, z) to the left and up in the image. The optical
frame used here is (x, y, z) = (-y, -z, x) in the axes of the paper.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics, Mount

MIN_DEPTH = 1e-6
"""Smallest depth that is divided by, in the unit of the points."""
MAX_NEWTON_STEPS = 6
LAST_NEWTON_STEP = 1e-7
"""Length of a Newton step below which the iteration ends: convergence is quadratic, so the next step would be
below 1e-12."""


def project(camera: CameraIntrinsics, points_c: Array) -> Array:
    """Eq. (12): project points of the optical frame to raw pixels.

    Args:
        points_c: (n, 3), of any scale: only the direction matters.

    Returns:
        (n, 2) u, v; meaningless for points behind the camera (`points_c[:, 2] <= 0`).
    """
    normalised = points_c[:, :2] / np.maximum(points_c[:, 2:], MIN_DEPTH)
    return _pixels(camera, _as_points(_distort(camera, _as_complex(normalised))[0]))


def project_with_jacobian(camera: CameraIntrinsics, points_c: Array) -> tuple[Array, Array]:
    """Eq. (14): project points to raw pixels, and differentiate these with respect to the points.

    Args:
        points_c: (n, 3), of any scale.

    Returns:
        (n, 2) pixels and (n, 2, 3) derivatives.
    """
    inverse_z = 1.0 / np.maximum(points_c[:, 2], MIN_DEPTH)
    normalised = points_c[:, :2] * inverse_z[:, None]
    distorted, by_z, by_conjugate = _distort(camera, _as_complex(normalised))
    lens = _jacobian(by_z, by_conjugate)
    jacobian = np.empty((len(points_c), 2, 3))
    jacobian[:, :, :2] = lens
    jacobian[:, :, 2] = -(lens @ normalised[:, :, None])[:, :, 0]
    jacobian *= np.array([[camera.fx_px], [camera.fy_px]]) * inverse_z[:, None, None]
    return _pixels(camera, _as_points(distorted)), jacobian


def bearing(camera: CameraIntrinsics, pixels: Array) -> Array:
    """Undo the lens: return the normalised coordinates (x/z, y/z) of raw pixels.

    Args:
        pixels: (n, 2) u, v.

    Returns:
        (n, 2); Newton's method, exact to rounding where the distortion can be inverted.
    """
    distorted = (pixels - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
    if not any(camera.distortion):
        return distorted
    wanted = _as_complex(distorted)
    z = wanted
    for _ in range(MAX_NEWTON_STEPS):
        reached, by_z, by_conjugate = _distort(camera, z)
        miss = reached - wanted
        step = by_z * miss - by_conjugate * miss.conj()
        step /= by_z**2 - by_conjugate.real**2 - by_conjugate.imag**2
        z = z - step
        if np.abs(step).max(initial=0.0) < LAST_NEWTON_STEP:
            break
    return _as_points(z)


def bearing_jacobian(camera: CameraIntrinsics, normalised: Array) -> Array:
    """Return the derivative (n, 2, 2) of `bearing` with respect to the pixels, at its result (n, 2)."""
    _, by_z, by_conjugate = _distort(camera, _as_complex(normalised))
    return np.linalg.inv(np.array([[camera.fx_px], [camera.fy_px]]) * _jacobian(by_z, by_conjugate))


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


def _as_complex(points: Array) -> NDArray[np.complex128]:
    """Return points (n, 2) as complex numbers x + iy (n,)."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def _as_points(z: NDArray[np.complex128]) -> Array:
    """Return complex numbers (n,) as points (n, 2)."""
    return z[:, None].view(np.float64)


def _distort(
    camera: CameraIntrinsics, z: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], Array, NDArray[np.complex128]]:
    """Apply the plumb-bob model of sensor_msgs/CameraInfo (Brown 1966), in complex numbers z = x + iy.

    With p = p2 + i p1 and r = |z|:

        distorted = z (1 + k1 r^2 + k2 r^4 + k3 r^6 + 2 Re(conj(p) z)) + p r^2

    Returns:
        (n,) distorted normalised coordinates, and their derivatives by z (real) and by conj(z) (Wirtinger).
    """
    k1, k2, p1, p2, k3 = camera.distortion
    p = complex(p2, p1)
    r2 = (z * z.conj()).real
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3))
    tangential = 2.0 * (p.conjugate() * z).real
    distorted = z * (radial + tangential) + p * r2
    return distorted, radial + slope * r2 + 2.0 * tangential, z * (slope * z + 2.0 * p)


def _jacobian(by_z: Array, by_conjugate: NDArray[np.complex128]) -> Array:
    """Return the derivative (n, 2, 2) by x and y from those by z (n,) and conj(z) (n,)."""
    jacobian = np.empty((len(by_z), 2, 2))
    jacobian[:, 0, 0] = by_z + by_conjugate.real
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = by_conjugate.imag
    jacobian[:, 1, 1] = by_z - by_conjugate.real
    return jacobian
