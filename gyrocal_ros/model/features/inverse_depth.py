"""Anchored inverse depth: bearing and inverse depth in the camera frame of the first observation.

After Montiel, Civera, Davison 2006: three parameters beside the position of the anchor, which features of one
image share. Its attitude is a constant; the error of that enters the bearing, correlated with the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.camera import bearing, bearing_jacobian, project_with_jacobian
from gyrocal_ros.model.features.base import (
    Anchors,
    NewFeatures,
    PosedCamera,
    Prediction,
    anchors_at,
)


@dataclass(frozen=True, slots=True)
class AnchoredInverseDepth:
    """(a, b, r): the point is `p_a + R_a (a, b, 1) / r` with the anchor camera at `p_a`, `R_a`.

    Without parallax the pixel hardly depends on r, so images at rest do not bias the depth.
    """

    name: str = 'inverse_depth'
    rows: int = 2
    needs_motion_gate: bool = False
    is_robust: bool = True
    is_anchored: bool = True

    def initialise(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> NewFeatures:
        """Take the bearing from the pixel, the inverse depth from the prior."""
        normalised = bearing(view.camera, pixels)
        inverse_depth = 1.0 / config.prior_depth_m
        count = len(pixels)
        parameters = np.concatenate([normalised, np.full((count, 1), inverse_depth)], axis=1)

        rays_c = np.concatenate([normalised, np.ones((count, 1))], axis=1)
        turned_c = (rays_c @ (view.R_wc.T @ view.dR_wc).transpose(0, 2, 1)).transpose(1, 2, 0)
        by_pose = np.zeros((count, 3, 6))
        by_pose[:, :2, 3:] = turned_c[:, :2] - normalised[:, :, None] * turned_c[:, 2:]
        by_pose[:, 2, 3:] = -inverse_depth * turned_c[:, 2]

        by_pixel = bearing_jacobian(view.camera, normalised)
        noise = np.zeros((count, 3, 3))
        noise[:, :2, :2] = noise_px**2 * by_pixel @ by_pixel.transpose(0, 2, 1)
        noise[:, 2, 2] = config.prior_inverse_depth_std**2
        anchors = anchors_at(np.tile(view.R_wc, (count, 1, 1)), np.tile(view.p_wc, (count, 1)))
        return NewFeatures(parameters, by_pose, noise, anchors, view.p_wc_by_pose)

    def measure(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> tuple[Array, Array]:
        """Return the pixels."""
        noise = np.zeros((len(pixels), 2, 2))
        noise[:, 0, 0] = noise[:, 1, 1] = noise_px**2
        return pixels, noise

    def predict(self, view: PosedCamera, parameters: Array, anchors: Anchors) -> Prediction:
        """Predict the pixels of `R_cw (R_a (a, b, 1) + r (p_a - p_c))`, the point scaled by r."""
        return Prediction(*predict_inverse_depth(view, parameters, anchors))

    def world(self, parameters: Array, anchors: Anchors) -> tuple[Array, Array]:
        """Return the point, for maps and plots; it is far away where the inverse depth is not positive."""
        inverse_depth = np.maximum(parameters[:, 2:], 1e-3)
        rays_c = np.concatenate([parameters[:, :2], np.ones((len(parameters), 1))], axis=1)
        rays_w = (anchors.R_wc @ rays_c[:, :, None])[:, :, 0]
        jacobian = np.empty((len(parameters), 3, 3))
        jacobian[:, :, :2] = anchors.R_wc[:, :, :2] / inverse_depth[:, :, None]
        jacobian[:, :, 2] = -rays_w / inverse_depth**2
        return anchors.p_wc + rays_w / inverse_depth, jacobian


@compiled
def predict_inverse_depth(view: PosedCamera, parameters: Array, anchors: Anchors) -> tuple[Array, ...]:
    """Return the fields of a `Prediction` in their order; see `AnchoredInverseDepth.predict`."""
    R_wc, R_wa, lever_c = view.R_wc, anchors.R_wc, view.p_bc @ view.R_bc
    inverse_depth = parameters[:, 2:]
    to_anchor = anchors.p_wc - view.p_wb
    rays_w = (R_wa[:, :, :2] @ parameters[:, :2, None])[:, :, 0] + R_wa[:, :, 2]
    from_robot = rays_w + inverse_depth * to_anchor
    points_c = from_robot @ R_wc - inverse_depth * lever_c

    by_pose = np.empty((len(parameters), 3, 6))
    by_pose[:, :, :3] = -inverse_depth[:, :, None] * R_wc.T
    by_pose[:, :, 3:] = (from_robot @ view.dR_wc).transpose(1, 2, 0)
    by_feature = np.empty((len(parameters), 3, 3))
    by_feature[:, :, :2] = R_wc.T @ R_wa[:, :, :2]
    by_feature[:, :, 2] = to_anchor @ R_wc - lever_c

    pixels, by_point = project_with_jacobian(view.camera, points_c)
    return pixels, by_point @ by_pose, by_point @ by_feature, points_c, by_point, parameters[:, 2]
