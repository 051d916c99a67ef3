"""Lens models of sensor_msgs/CameraInfo: normalised coordinates (x/z, y/z) to distorted ones and back.

A distorted coordinate times the focal length, plus the principal point, is a pixel.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.kernels import compiled

COEFFICIENT_COUNTS = {'plumb_bob': 5, 'rational_polynomial': 8, 'equidistant': 4}
"""Lens models by their names in CameraInfo, with their numbers of coefficients."""

MAX_NEWTON_STEPS = 20
LAST_NEWTON_STEP = 1e-5
"""Length of a Newton step below which the iteration ends: convergence is quadratic, so the remaining error is
about 1e-10, less than a millionth of a pixel."""
MAX_ANGLE_RAD = math.radians(89.0)
"""Largest angle from the optical axis: x/z is infinite at 90 deg."""
SMALL_RADIUS = 1e-4
"""Radius below which the power series of an equidistant lens is exact to rounding."""


def is_undistorted(camera: CameraIntrinsics) -> bool:
    """Return True if the camera is a pinhole camera."""
    return camera.lens != 'equidistant' and not any(camera.distortion)


def distort(camera: CameraIntrinsics, normalised: Array) -> tuple[Array, Array]:
    """Apply the lens to normalised coordinates (n, 2).

    Returns:
        (n, 2) distorted coordinates and their derivative (n, 2, 2).
    """
    if is_undistorted(camera):
        return normalised, np.tile(np.eye(2), (len(normalised), 1, 1))
    if camera.lens == 'equidistant':
        return _distort_equidistant(camera.distortion, normalised)
    return _distort_brown(camera.distortion, normalised)


def undistort(camera: CameraIntrinsics, distorted: Array) -> Array:
    """Return the normalised coordinates (n, 2) of distorted ones: the inverse of `distort`.

    Newton's method; the error is below 1e-8 where the distortion can be inverted. An equidistant lens also
    sees points beside and behind the camera; they are returned at `MAX_ANGLE_RAD`.

    Args:
        camera: intrinsics.
        distorted: (n, 2).
    """
    if is_undistorted(camera):
        return distorted
    if camera.lens == 'equidistant':
        return _undistort_equidistant(camera.distortion, distorted)
    return undistort_brown(camera, distorted, MAX_NEWTON_STEPS, LAST_NEWTON_STEP)


@compiled
def undistort_brown(camera: CameraIntrinsics, distorted: Array, max_steps: int, last_step: float) -> Array:
    """Return the normalised coordinates (n, 2) behind a lens with radial and tangential distortion.

    Args:
        camera: intrinsics.
        distorted: (n, 2)
        max_steps: largest number of Newton steps.
        last_step: length of a step below which the iteration ends.
    """
    normalised = distorted
    for _ in range(max_steps):
        reached, slope = _distort_brown(camera.distortion, normalised)
        step = _solve_symmetric(slope, reached - distorted)
        normalised = normalised - step
        if np.abs(step).max(initial=0.0) < last_step:
            break
    return normalised


def by_radial_coefficients(camera: CameraIntrinsics, normalised: Array) -> Array:
    """Differentiate the distorted coordinates (n, 2) with respect to k1 and k2: (n, 2, 2), k1 first."""
    r2 = np.sum(normalised**2, axis=1)
    if camera.lens == 'equidistant':
        r = np.maximum(np.sqrt(r2), SMALL_RADIUS)
        angle = np.arctan(r)
        first, second = angle**3 / r, angle**5 / r
    else:
        first, second = r2, r2 * r2
        if any(camera.distortion[5:]):
            denominator, _ = _rational_denominator(camera.distortion, r2)
            first, second = first / denominator, second / denominator
    return normalised[:, :, None] * np.stack([first, second], axis=1)[:, None]


def _solve_symmetric(matrices: Array, right: Array) -> Array:
    """Solve n symmetric systems (n, 2, 2) for right sides (n, 2), by Cramer's rule."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    x, y = right[:, 0], right[:, 1]
    return np.stack([c * x - b * y, a * y - b * x], axis=1) / (a * c - b * b)[:, None]


def _distort_brown(coefficients: tuple[float, ...], normalised: Array) -> tuple[Array, Array]:
    """Apply radial and tangential distortion (Brown 1966), with three coefficients or a rational function."""
    k1, k2, p1, p2, k3 = coefficients[:5]
    jacobian = np.empty((len(normalised), 2, 2))
    x, y = normalised[:, 0], normalised[:, 1]
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3)))
    if any(coefficients[5:]):
        denominator, denominator_slope = _rational_denominator(coefficients, r2)
        radial = radial / denominator
        slope = (slope - radial * denominator_slope) / denominator
    distorted = normalised * radial[:, None]
    distorted[:, 0] += 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx)
    distorted[:, 1] += p1 * (r2 + 2.0 * yy) + 2.0 * p2 * xy
    jacobian[:, 0, 0] = radial + slope * xx + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = slope * xy + 2.0 * (p1 * x + p2 * y)
    jacobian[:, 1, 1] = radial + slope * yy + 6.0 * p1 * y + 2.0 * p2 * x
    return distorted, jacobian


def _rational_denominator(coefficients: tuple[float, ...], r2: Array) -> tuple[Array, Array]:
    """Return 1 + k4 r^2 + k5 r^4 + k6 r^6 (n,), and its derivative by r over r (n,)."""
    k4, k5, k6 = coefficients[5:] or (0.0, 0.0, 0.0)
    slope = 2.0 * (k4 + r2 * (2.0 * k5 + r2 * (3.0 * k6)))
    return 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)), slope


def _distort_equidistant(coefficients: tuple[float, ...], normalised: Array) -> tuple[Array, Array]:
    """Apply the fisheye model (Kannala, Brandt 2006): the radius is an odd polynomial of the angle."""
    r2 = np.sum(normalised**2, axis=1)
    r = np.sqrt(np.maximum(r2, SMALL_RADIUS**2))
    bent, bent_slope = _bent_angle(coefficients, np.arctan(r))
    scale = bent / r
    slope = (bent_slope / (1.0 + r * r) - scale) / (r * r)  # derivative of the scale by r, over r
    small = r2 < SMALL_RADIUS**2
    slope = np.where(small, 2.0 * (coefficients[0] - 1.0 / 3.0), slope)
    scale = np.where(small, 1.0 + 0.5 * slope * r2, scale)
    outer = normalised[:, :, None] * normalised[:, None, :]
    return normalised * scale[:, None], scale[:, None, None] * np.eye(2) + slope[:, None, None] * outer


def _undistort_equidistant(coefficients: tuple[float, ...], distorted: Array) -> Array:
    bent = np.sqrt(np.sum(distorted**2, axis=1))
    angle = np.minimum(bent, MAX_ANGLE_RAD)
    for _ in range(MAX_NEWTON_STEPS):
        reached, slope = _bent_angle(coefficients, angle)
        step = (reached - bent) / slope
        angle = np.clip(angle - step, 0.0, MAX_ANGLE_RAD)
        if np.abs(step).max(initial=0.0) < LAST_NEWTON_STEP:
            break
    scale = np.where(bent > 0.0, np.tan(angle) / np.maximum(bent, 1e-300), 1.0)
    return distorted * scale[:, None]


def _bent_angle(coefficients: tuple[float, ...], angle: Array) -> tuple[Array, Array]:
    """Return angle (1 + k1 angle^2 + ... + k4 angle^8) (n,), and its derivative (n,)."""
    k1, k2, k3, k4 = coefficients
    a2 = angle * angle
    bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
    return bent, 1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
