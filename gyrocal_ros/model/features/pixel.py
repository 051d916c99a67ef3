"""The conventional parametrisation: a world point, measured as a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array
from gyrocal_ros.model.camera import project_with_jacobian
from gyrocal_ros.model.features.base import Anchors, NewFeatures, PosedCamera, Prediction, points_in_camera
from gyrocal_ros.model.features.camera_frame import CameraFramePoint


@dataclass(frozen=True, slots=True)
class PixelPoint:
    """World point (x, y, z), initialised as in the paper and measured by eq. (12).

    For comparison: strongly nonlinear while the depth is unknown, so it fails as the paper says.
    """

    name: str = 'pixel'
    rows: int = 2
    needs_motion_gate: bool = False
    is_robust: bool = False
    is_anchored: bool = False

    def initialise(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> NewFeatures:
        """Initialise as the paper does, eq. (18)."""
        return CameraFramePoint().initialise(view, pixels, noise_px, config)

    def measure(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> tuple[Array, Array]:
        """Return the pixels."""
        return pixels, np.broadcast_to(noise_px**2 * np.eye(2), (len(pixels), 2, 2))

    def predict(self, view: PosedCamera, parameters: Array, anchors: Anchors) -> Prediction:
        """Predict the pixels of the mapped points."""
        points_c, by_pose, R_cw = points_in_camera(view, parameters)
        pixels, by_point = project_with_jacobian(view.camera, points_c)
        return Prediction(
            pixels, by_point @ by_pose, by_point @ R_cw, points_c, by_point, np.ones(len(points_c))
        )

    def world(self, parameters: Array, anchors: Anchors) -> tuple[Array, Array]:
        """Return the parameters, which are the point."""
        return parameters, np.broadcast_to(np.eye(3), (len(parameters), 3, 3))
