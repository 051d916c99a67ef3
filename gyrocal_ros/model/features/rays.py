"""Points along rays, and the paper's noise of a point whose range is nearly unknown."""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import bearing


def ray_points(camera: CameraIntrinsics, pixels: Array, range_m: float) -> Array:
    """Eqs. (16), (17): return the points (m, 3) at the assumed range `d` along the rays of the pixels.

    The paper computes azimuth `atan(u / f)` and elevation `atan(v / sqrt(u^2 + f^2))`, which omits the image
    centre, and the unit vector from them. The normalised ray is the same vector, and valid in all quadrants.
    """
    normalised = bearing(camera, pixels)
    rays = np.concatenate([normalised, np.ones((len(pixels), 1))], axis=1)
    return range_m * rays / np.linalg.norm(rays, axis=1, keepdims=True)


def ray_covariances(points_c: Array, cross_std_m: float, ray_std_m: float) -> Array:
    """Eqs. (19), (22): return the covariances (m, 3, 3) of points seen along rays, in the camera frame.

    In the frame of the ray the covariance is `diag(e_ct^2, e_cn^2, e_cn^2)`. Rotated to the camera frame it
    is `e_cn^2 I + (e_ct^2 - e_cn^2) r r^T` with r the direction of the ray.
    """
    directions = points_c / np.linalg.norm(points_c, axis=1, keepdims=True)
    along = directions[:, :, None] * directions[:, None, :]
    return cross_std_m**2 * np.eye(3) + (ray_std_m**2 - cross_std_m**2) * along


def ray_std(config: FeatureConfig) -> float:
    """Eq. (20): return the standard deviation `e_ct` along the ray; the paper uses 30 m to 1000 m."""
    return config.ray_std_m


def cross_std(camera: CameraIntrinsics, noise_px: float, config: FeatureConfig) -> float:
    """Eq. (21): return the std `e_cn = (d / f) sqrt(e_trk^2 + e_cal^2)` across the ray, in metres."""
    focal_px = math.sqrt(camera.fx_px * camera.fy_px)
    return config.prior_depth_m / focal_px * math.hypot(noise_px, config.calibration_noise_px)
