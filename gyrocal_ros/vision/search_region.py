"""Search regions of features, and the exhaustive search of a region too large for Lucas-Kanade."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.vision.lens_table import approximate_bearing
from gyrocal_ros.vision.patches import NODE_CENTRE, grid, node_basis

SIGMAS = 3.5
"""Half-axes of a search region in standard deviations."""
EXTRA_STD_PX = 1.0
"""Standard deviation added to every region, because the filter's covariance is only as good as its model."""
MIN_RAY_Z = 0.05
"""Minimum z of a ray in world axes; flatter rays are raised to it."""


def ceiling_coordinates(camera: CameraIntrinsics, pixels: Array, R_wc: Array) -> Array:
    """Return ceiling coordinates in units of the ceiling's distance: x/z, y/z of the ray in world axes.

    Args:
        pixels: (..., 2).
        R_wc: (3, 3) attitude of the camera.

    Returns:
        (..., 2). On any horizontal plane, the difference of two points is invariant while the camera
        moves and turns below it at constant height.
    """
    pixels_2d = pixels.reshape(-1, 2)
    return _on_ceiling(bearing(camera, pixels_2d), R_wc).reshape(pixels.shape)


def approximate_ceiling(camera: CameraIntrinsics, pixels: Array, R_wc: Array) -> Array:
    """Return `ceiling_coordinates` (n, 2) of pixels (n, 2) but faster, to some tenths of a pixel.

    That is enough to predict where a feature is searched for.
    """
    approximate = approximate_bearing(camera, pixels)
    return _on_ceiling(bearing(camera, pixels) if approximate is None else approximate, R_wc)


def ceiling_pixels(camera: CameraIntrinsics, ceiling: Array, R_wc: Array) -> Array:
    """Return pixels (..., 2) of ceiling coordinates (..., 2): the inverse of `ceiling_coordinates`."""
    rays_c = _homogeneous(ceiling.reshape(-1, 2)) @ R_wc
    return project(camera, rays_c).reshape(ceiling.shape)


def in_region(offsets: Array, covariances: Array) -> NDArray[np.bool_]:
    """Return which offsets (n, 2) from the prediction are in the region of the covariance (n or 1, 2, 2)."""
    a, b, c = (covariances + EXTRA_STD_PX**2 * np.eye(2)).reshape(-1, 4)[:, [0, 1, 3]].T
    u, v = offsets.T
    distances: Array = (c * u * u - 2.0 * b * u * v + a * v * v) / (a * c - b * b)
    return distances <= SIGMAS**2


def region_radius(covariances: Array) -> Array:
    """Return the radius (n,) of each region, the longer half-axis, in whole pixels."""
    a, b, c = covariances.reshape(-1, 4)[:, [0, 1, 3]].T
    largest = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b) + EXTRA_STD_PX**2
    return np.ceil(SIGMAS * np.sqrt(largest))


def best_match(image: NDArray[np.uint8], template: Array, nodes: Array, covariance: Array) -> Array:
    """Find the position of best correlation of a patch in its region, to the pixel.

    The region is resampled along the axes of the patch, so that the patch itself is not resampled.

    Args:
        image: (height, width).
        template: (m,) grey values of the patch.
        nodes: (9, 2) pixels of the predicted `node_offsets` of the patch.
        covariance: (2, 2) of the prediction.

    Returns:
        (2,) offset in pixels, to be added to `nodes`.
    """
    size = round(len(template) ** 0.5)
    basis = node_basis(nodes[None], size)[0]
    radius = int(region_radius(covariance[None])[0])
    region = np.clip(nodes[NODE_CENTRE] + grid(size + 2 * radius) @ basis, -1e4, 1e4).astype(np.float32)
    resampled = cv2.remap(image, region[:, None], None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    scores = cv2.matchTemplate(
        resampled.reshape(size + 2 * radius, -1).astype(np.float32),
        template.reshape(size, size).astype(np.float32),
        cv2.TM_CCOEFF_NORMED,
    ).ravel()
    offsets = grid(2 * radius + 1) @ basis
    allowed = in_region(offsets, covariance[None]) & np.isfinite(scores)
    return offsets[np.argmax(np.where(allowed, scores, -2.0))]


def _on_ceiling(normalised: Array, R_wc: Array) -> Array:
    rays_w = _homogeneous(normalised) @ R_wc.T
    on_ceiling: Array = rays_w[:, :2] / np.maximum(rays_w[:, 2:], MIN_RAY_Z)
    return on_ceiling


def _homogeneous(coordinates: Array) -> Array:
    return np.concatenate([coordinates, np.ones((len(coordinates), 1))], axis=1)
