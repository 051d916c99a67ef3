"""Contract of a feature parametrisation: the parameters of a point, and the quantities that are measured."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from gyrocal_ros.config.sections import FeatureConfig
from gyrocal_ros.data import Array, CameraIntrinsics, IntArray, Mount, quickly_filled
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.rotation import rotation_derivatives, rotation_from_euler


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """A camera at a robot pose, with the matrices for derivatives by that pose."""

    camera: CameraIntrinsics
    p_wb: Array
    """(3,) robot position."""
    R_wb: Array
    """(3, 3)"""
    dR_wb: Array
    """(3, 3, 3) derivatives of `R_wb` by roll, pitch, yaw."""
    R_wc: Array
    """(3, 3) attitude of the camera."""
    dR_wc: Array
    """(3, 3, 3) its derivatives by roll, pitch, yaw."""
    p_wc: Array
    """(3,) its position."""
    R_bc: Array
    p_bc: Array
    shift: Array
    """Mounting, see `Mount`."""

    @property
    def p_wc_by_pose(self) -> Array:
        """(3, 6) derivative of the position of the camera by the robot pose."""
        return np.concatenate([np.eye(3), (self.dR_wb @ self.p_bc).T], axis=1)


def posed_camera(camera: CameraIntrinsics, mount: Mount, position_m: Array, euler_rad: Array) -> PosedCamera:
    """Put the camera at a robot pose (position (3,), Euler angles (3,))."""
    turned = turned_camera(position_m, euler_rad, mount.R_bs, mount.p_bs)
    return PosedCamera(camera, position_m, *turned, mount.R_bs, mount.p_bs, mount.shift)


@compiled
def turned_camera(
    position_m: Array, euler_rad: Array, R_bc: Array, p_bc: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return `R_wb`, `dR_wb`, `R_wc`, `dR_wc` and `p_wc` of a `PosedCamera`, see `posed_camera`."""
    R_wb, dR_wb = rotation_from_euler(euler_rad), rotation_derivatives(euler_rad)
    return R_wb, dR_wb, R_wb @ R_bc, dR_wb @ R_bc, position_m + R_wb @ p_bc


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """Camera poses at the first observation of each feature."""

    R_wc: Array
    """(m, 3, 3)"""
    p_wc: Array
    """(m, 3)"""
    by_values: Array
    """(m, 3, k) derivative of the positions by coefficients that move the camera; k is 0 without any."""
    by_candidates: Array
    """(m, 3, c) the same by the coefficients of candidates."""

    def __getitem__(self, rows: IntArray) -> Anchors:
        return Anchors(
            self.R_wc.take(rows, 0),
            self.p_wc.take(rows, 0),
            self.by_values.take(rows, 0),
            self.by_candidates.take(rows, 0),
        )

    def joined(self, other: Anchors) -> Anchors:
        """Return these anchors followed by the other ones, whose coefficients are the same."""
        if not len(self.p_wc):
            return other
        pairs = ((getattr(self, item.name), getattr(other, item.name)) for item in fields(self))
        return Anchors(*map(np.concatenate, pairs))


def anchors_at(R_wc: Array, p_wc: Array) -> Anchors:
    """Return anchors that no effect moves, at attitudes (m, 3, 3) and positions (m, 3)."""
    unmoved = np.zeros((len(p_wc), 3, 0))
    return Anchors(R_wc, p_wc, unmoved, unmoved)


def no_anchors(count: int) -> Anchors:
    """Return anchors without information: for an empty map, or for features that are world points."""
    return anchors_at(np.zeros((count, 3, 3)), np.zeros((count, 3)))


@dataclass(frozen=True, slots=True, eq=False)
class NewFeatures:
    """Features at their first observation, with the derivative and the noise that eq. (18) takes."""

    parameters: Array
    """(m, 3)"""
    by_pose: Array
    """(m, 3, 6) derivative of the parameters with respect to the robot pose."""
    noise: Array
    """(m, 3, 3) covariance from the measurement and the prior depth, `Jz R Jz^T`."""
    anchors: Anchors
    anchor_by_pose: Array | None = None
    """(3, 6) derivative of the position of the anchors; None where features have none."""


@quickly_filled
@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted measurements of mapped features in a view, with their derivatives."""

    expected: Array
    """(m, r)"""
    by_pose: Array
    """(m, r, 6)"""
    by_feature: Array
    """(m, r, 3)"""
    points_c: Array
    """(m, 3) features in the optical frame, times `scale`; a third value <= 0 is behind the camera."""
    by_point: Array
    """(m, r, 3) derivative of the predicted measurement with respect to `points_c`."""
    scale: Array
    """(m,) inverse depth where the parametrisation carries it, else 1."""

    def __getitem__(self, rows: IntArray) -> Prediction:
        return Prediction(
            self.expected.take(rows, 0),
            self.by_pose.take(rows, 0),
            self.by_feature.take(rows, 0),
            self.points_c.take(rows, 0),
            self.by_point.take(rows, 0),
            self.scale.take(rows, 0),
        )


class Parametrisation(Protocol):
    """Three parameters per feature, `rows` measured numbers per observation. Arrays are over m features."""

    @property
    def name(self) -> str: ...

    @property
    def rows(self) -> int:
        """r, measured numbers per observation."""

    @property
    def needs_motion_gate(self) -> bool:
        """True if camera updates must wait until the robot has moved."""

    @property
    def is_robust(self) -> bool:
        """True if features are judged by each other; the forms for comparison are updated as in the paper."""

    @property
    def is_anchored(self) -> bool:
        """True if a feature is direction and inverse depth in the camera of its first sight."""

    def initialise(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> NewFeatures:
        """Initialise features from one observation (m, 2), without delay."""

    def measure(
        self, view: PosedCamera, pixels: Array, noise_px: float, config: FeatureConfig
    ) -> tuple[Array, Array]:
        """Return the measurement (m, r) and its noise covariance (m, r, r)."""

    def predict(self, view: PosedCamera, parameters: Array, anchors: Anchors) -> Prediction:
        """Predict the measurement."""

    def world(self, parameters: Array, anchors: Anchors) -> tuple[Array, Array]:
        """Return points in the world (m, 3) and their derivatives by the parameters (m, 3, 3)."""


def points_in_camera(view: PosedCamera, points_w: Array) -> tuple[Array, Array, Array]:
    """Eq. (13): transform world points to the optical frame, `m_c = C_cw (m_w - p) - C_cb p_offset`.

    Returns:
        (m, 3) points, (m, 3, 6) derivative by the pose, (3, 3) derivative by the points.
    """
    R_cw = view.R_wc.T
    offset = points_w - view.p_wb
    points_c = offset @ R_cw.T - view.p_bc @ view.R_bc
    by_pose = np.empty((len(points_w), 3, 6))
    by_pose[:, :, :3] = -R_cw
    by_pose[:, :, 3:] = (offset @ view.dR_wc).transpose(1, 2, 0)
    return points_c, by_pose, R_cw


def points_in_world(view: PosedCamera, points_c: Array) -> tuple[Array, Array]:
    """Eq. (15): transform points of the optical frame to the world, `m_w = p + C_wb (p_offset + C_bc m_c)`.

    Returns:
        (m, 3) points and their derivative by the pose (m, 3, 6).
    """
    points_b = view.p_bc + points_c @ view.R_bc.T
    by_pose = np.empty((len(points_c), 3, 6))
    by_pose[:, :, :3] = np.eye(3)
    by_pose[:, :, 3:] = (points_b @ view.dR_wb.transpose(0, 2, 1)).transpose(1, 2, 0)
    return view.p_wb + points_b @ view.R_wb.T, by_pose
