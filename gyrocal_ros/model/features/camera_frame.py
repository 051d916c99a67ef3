"""The paper's parametrisation: a world point, measured as a point in the camera frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array
from gyrocal_ros.model.features.base import (
    Anchors,
    NewFeatures,
    PosedCamera,
    Prediction,
    no_anchors,
    points_in_camera,
    points_in_world,
)
from gyrocal_ros.model.features.rays import cross_std, ray_covariances, ray_points, ray_std


@dataclass(frozen=True, slots=True)
class CameraFramePoint:
    """World point (x, y, z); the camera is treated as a range and bearing sensor of unknown range.

    The measurement is linear in the feature, but not in the attitude, and its noise has the axes of the noisy
    ray: without parallax, noise of the ray looks like parallax. Hence the motion gate.
    """

    name: str = 'camera_frame'
    rows: int = 3
    needs_motion_gate: bool = True
    is_robust: bool = False
    is_anchored: bool = False

    def initialise(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> NewFeatures:
        """Return the point at the assumed range, its covariance rotated from the ray to the world."""
        points_c, noise_c = self.measure(view, pixels, noise_px, config)
        points_w, by_pose = points_in_world(view, points_c)
        return NewFeatures(points_w, by_pose, view.R_wc @ noise_c @ view.R_wc.T, no_anchors(len(points_w)))

    def measure(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> tuple[Array, Array]:
        """Return the point at the assumed range, (m, 3), and the noise of its ray."""
        points_c = ray_points(view.camera, pixels, config.prior_depth_m)
        cross = cross_std(view.camera, noise_px, config)
        return points_c, ray_covariances(points_c, cross, ray_std(config))

    def predict(self, view: PosedCamera, parameters: Array, anchors: Anchors) -> Prediction:
        """Predict the mapped points in the camera frame."""
        points_c, by_pose, R_cw = points_in_camera(view, parameters)
        each = (len(points_c), 3, 3)
        by_point = np.broadcast_to(np.eye(3), each)
        by_feature = np.broadcast_to(R_cw, each)
        return Prediction(points_c, by_pose, by_feature, points_c, by_point, np.ones(len(points_c)))

    def world(self, parameters: Array, anchors: Anchors) -> tuple[Array, Array]:
        """Return the parameters, which are the point."""
        return parameters, np.broadcast_to(np.eye(3), (len(parameters), 3, 3))
