"""A table of undistorted pixels, which predicts where a feature is searched for."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import bearing, project
from gyrocal_ros.model.lens import is_undistorted

CELL_PX = 4
"""Distance of the nodes of the table."""
MAX_ERROR_PX = 0.01
"""Error of a node above which the lens cannot be inverted there."""


def approximate_bearing(camera: CameraIntrinsics, pixels: Array) -> Array | None:
    """Return the normalised coordinates (n, 2) of pixels (n, 2).

    Between the nodes they are interpolated bilinearly, to some hundredths of a pixel, at the edge of a very
    wide lens to one; outside the image they are extrapolated. None for a lens that is undone as fast without
    a table: a pinhole, or a fisheye lens, whose angle alone is solved for.
    """
    if camera.lens == 'equidistant' or is_undistorted(camera):
        return None
    table = _table(camera)
    rows, columns = table.shape[:2]
    nodes = pixels / CELL_PX
    corner = np.clip(nodes, 0.0, [columns - 2, rows - 2]).astype(np.intp)
    right, down = (nodes - corner).T[:, :, None]
    flat, index = table.reshape(-1, 2), corner[:, 1] * columns + corner[:, 0]
    upper = (1.0 - right) * flat[index] + right * flat[index + 1]
    lower = (1.0 - right) * flat[index + columns] + right * flat[index + columns + 1]
    between: Array = (1.0 - down) * upper + down * lower
    return between


@lru_cache(maxsize=4)
def _table(camera: CameraIntrinsics) -> Array:
    """Return the normalised coordinates (rows, columns, 2) of every `CELL_PX`-th pixel."""
    u, v = (np.arange(0, side + CELL_PX, CELL_PX) for side in (camera.width_px, camera.height_px))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2).astype(float)
    table = bearing(camera, pixels)
    pinhole = (pixels - [camera.cx_px, camera.cy_px]) / [camera.fx_px, camera.fy_px]
    rays = np.concatenate([table, np.ones((len(table), 1))], axis=1)
    wrong = ~(np.abs(project(camera, rays) - pixels).max(axis=1) < MAX_ERROR_PX)
    table[wrong] = pinhole[wrong]
    return table.reshape(len(v), len(u), 2)
