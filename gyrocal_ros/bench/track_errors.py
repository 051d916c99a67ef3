"""Errors of whole tracks against true poses of the camera.

The point of each track is triangulated from all its observations with the true poses (Hartley and Zisserman
2004, ch. 12), so that the distance of the observations from its projection is the error of the tracker alone.
A filter averages errors that differ from image to image, but not those that remain along a track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, FeatureObservations
from gyrocal_ros.model.camera import bearing, project_with_jacobian

MOVED_PX = 1.0
"""Distance that a feature must have moved since its last observation that counts: at rest errors repeat."""
MIN_OBSERVATIONS = 8
"""Smallest number of such observations of a track."""
MIN_PARALLAX_RAD = 0.05
"""Smallest angle between the first and the last ray for a triangulation."""
GAUSS_NEWTON_STEPS = 8
POINT_PARAMETERS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The k images in which one feature counts."""

    pixels: Array
    """(k, 2)"""
    R_wc: Array
    """(k, 3, 3) true attitudes of the camera."""
    p_wc: Array
    """(k, 3) true positions of the camera."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackErrors:
    """Errors of n tracks in pixels for each coordinate."""

    rms_px: Array
    """(n,) all errors."""
    white_px: Array
    """(n,) the part that is independent from observation to observation."""
    slow_px: Array
    """(n,) the rest, which remains over several observations."""
    points_w: Array
    """(n, 3) triangulated points."""


def track_row(drives: Sequence[TrackErrors]) -> dict[str, float]:
    """Return the figures of the tracks of several drives: medians, and quantiles of the slow part."""
    rms, white, slow = (
        np.concatenate([getattr(errors, name) for errors in drives])
        for name in ('rms_px', 'white_px', 'slow_px')
    )
    return {'tracks': len(slow)} | {
        name: float(np.quantile(values, share)) if len(values) else np.nan
        for name, values, share in (
            ('rms_px', rms, 0.5),
            ('white_px', white, 0.5),
            ('slow_px', slow, 0.5),
            ('slow_5_px', slow, 0.05),
            ('slow_95_px', slow, 0.95),
        )
    }


def track_errors(
    camera: CameraIntrinsics, seen: Sequence[FeatureObservations], R_wc: Array, p_wc: Array
) -> TrackErrors:
    """Return the errors of all tracks that are long enough.

    Args:
        camera: intrinsics of the images.
        seen: the features of k images.
        R_wc: (k, 3, 3) true attitudes of the camera.
        p_wc: (k, 3) true positions of the camera.
    """
    found = []
    for rows in _moving_tracks(seen).values():
        if len(rows) < MIN_OBSERVATIONS:
            continue
        numbers = [number for number, _ in rows]
        views = Views(np.array([pixel for _, pixel in rows]), R_wc[numbers], p_wc[numbers])
        if _parallax(camera, views) > MIN_PARALLAX_RAD:
            point_w, errors = triangulate(camera, views)
            found.append((*_split(errors), *point_w))
    table = np.array(found).reshape(-1, 3 + POINT_PARAMETERS)
    return TrackErrors(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


def triangulate(camera: CameraIntrinsics, views: Views) -> tuple[Array, Array]:
    """Return the point (3,) that fits the views best, and the errors (k, 2) of the pixels.

    Least squares: linear in the rays first, then Gauss-Newton in the pixels.
    """
    rays_w = _rays(camera, views)
    across = np.eye(3) - rays_w[:, :, None] * rays_w[:, None, :]
    point_w = np.linalg.lstsq(across.reshape(-1, 3), (across @ views.p_wc[:, :, None]).ravel(), rcond=None)[0]
    for _ in range(GAUSS_NEWTON_STEPS):
        points_c = ((point_w - views.p_wc)[:, None, :] @ views.R_wc)[:, 0]
        pixels, by_point_c = project_with_jacobian(camera, points_c)
        errors = views.pixels - pixels
        by_point_w = (by_point_c @ views.R_wc.transpose(0, 2, 1)).reshape(-1, 3)
        point_w = point_w + np.linalg.lstsq(by_point_w, errors.ravel(), rcond=None)[0]
    return point_w, errors


def _moving_tracks(seen: Sequence[FeatureObservations]) -> dict[int, list[tuple[int, Array]]]:
    """Return number of the image and pixel of the observations of each id that count."""
    tracks: dict[int, list[tuple[int, Array]]] = {}
    for number, image in enumerate(seen):
        for id_, pixel in zip(image.ids.tolist(), image.pixels, strict=True):
            track = tracks.setdefault(id_, [])
            if not track or np.linalg.norm(pixel - track[-1][1]) > MOVED_PX:
                track.append((number, pixel))
    return tracks


def _rays(camera: CameraIntrinsics, views: Views) -> Array:
    """Return the unit vectors (k, 3) from the camera to the feature, in world axes."""
    rays_c = np.column_stack([bearing(camera, views.pixels), np.ones(len(views.pixels))])
    rays_w = (views.R_wc @ rays_c[:, :, None])[:, :, 0]
    return rays_w / np.linalg.norm(rays_w, axis=1, keepdims=True)


def _parallax(camera: CameraIntrinsics, views: Views) -> float:
    """Return the largest angle between the first ray and another."""
    rays_w = _rays(camera, views)
    return float(np.arccos(np.clip(rays_w @ rays_w[0], -1.0, 1.0)).max())


def _split(errors: Array) -> tuple[float, float, float]:
    """Return rms, white and slow part of errors (k, 2) about a triangulated point.

    White noise has twice its variance from observation to observation.
    """
    variance = (errors**2).sum() / (errors.size - POINT_PARAMETERS)
    white = min(0.5 * float((np.diff(errors, axis=0) ** 2).mean()), variance)
    return float(np.sqrt(variance)), float(np.sqrt(white)), float(np.sqrt(variance - white))
