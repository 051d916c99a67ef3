"""Simulation of the room and of a feature tracker: ceiling corners, and furniture that occludes them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, IntArray
from gyrocal_ros.model.camera import in_image, project


@dataclass(frozen=True, slots=True)
class Furniture:
    """A table or a bed: a level board that the robot drives below."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    height_m: float = 0.45
    """Height of the underside above the floor."""
    marks: int = 0
    """Number of corners on the underside, as of screws and joints; without any it is plain and dark."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The corners and the furniture of a room."""

    points_w: Array
    """(m, 3) corners, strongest first, in the order in which a tracker selects them."""
    furniture: tuple[Furniture, ...] = ()


def draw_scene(
    rng: np.random.Generator,
    room_m: tuple[float, float],
    camera_height_m: float,
    furniture: tuple[Furniture, ...] = (),
    corners: int = 60,
    lamps: int = 8,
) -> Scene:
    """Draw corners on a ceiling with several levels, and a few lower ones on lamps and shelves.

    Args:
        rng: the random stream of the scene.
        room_m: length and width, around the origin.
        camera_height_m: height of the camera above the floor.
        furniture: furniture that occludes the ceiling, and shows corners of its own.
        corners: number of corners on the ceiling, 2.0 to 2.7 m above the camera.
        lamps: number of corners 1.2 to 2.0 m above the camera.
    """
    count = corners + lamps
    half = np.array(room_m) / 2.0
    level = rng.uniform(-half, half, (count, 2))
    height = np.where(
        rng.permutation(count) < lamps, rng.uniform(1.2, 2.0, count), rng.uniform(2.0, 2.7, count)
    )
    above = np.column_stack([level, camera_height_m + height])
    return Scene(np.concatenate([above, *(_undersides(rng, board) for board in furniture)]), furniture)


def _undersides(rng: np.random.Generator, board: Furniture) -> Array:
    """Draw the corners (n, 3) on the underside of a piece of furniture."""
    (x0, x1), (y0, y1) = board.x_m, board.y_m
    level = rng.uniform((x0, y0), (x1, y1), (board.marks, 2))
    return np.column_stack([level, np.full(board.marks, board.height_m)])


def occluded(furniture: tuple[Furniture, ...], camera_w: Array, points_w: Array) -> np.ndarray:
    """Return which points (m, 3) are occluded by furniture at each camera position (n, 3): (n, m) bool."""
    result = np.zeros((len(camera_w), len(points_w)), dtype=bool)
    rise = points_w[:, 2] - camera_w[:, 2:]
    for board in furniture:
        share = (board.height_m - camera_w[:, 2:]) / rise
        x = camera_w[:, :1] + share * (points_w[:, 0] - camera_w[:, :1])
        y = camera_w[:, 1:2] + share * (points_w[:, 1] - camera_w[:, 1:2])
        inside = (x > board.x_m[0]) & (x < board.x_m[1]) & (y > board.y_m[0]) & (y < board.y_m[1])
        result |= inside & (share > 0.0) & (share < 1.0)
    return result


def project_corners(
    scene: Scene, camera: CameraIntrinsics, R_wc: Array, p_wc: Array, border_px: float = 8.0
) -> tuple[Array, np.ndarray]:
    """Project every corner into n images taken from the poses R_wc (n, 3, 3), p_wc (n, 3).

    Returns:
        (n, m, 2) raw pixels, and (n, m) bool, True if visible.
    """
    points_c = np.einsum('nij,nmi->nmj', R_wc, scene.points_w - p_wc[:, None, :])
    flat = points_c.reshape(-1, 3)
    pixels = project(camera, flat)
    seen = in_image(camera, pixels, border_px) & (flat[:, 2] > 0.1)
    shape = points_c.shape[:2]
    return pixels.reshape(*shape, 2), seen.reshape(shape) & ~occluded(scene.furniture, p_wc, scene.points_w)


def track_corners(
    seen: np.ndarray, time_s: Array, features: int, reacquire_s: float
) -> Iterator[tuple[IntArray, IntArray]]:
    """Track corners as a feature tracker does: each until it is lost, then replaced by a new one.

    A corner that is reacquired in time keeps its id; after that its id is never used again.

    Args:
        seen: (n, m) True if a corner can be tracked in an image.
        time_s: (n,) times of the images.
        features: number of corners tracked at a time.
        reacquire_s: time for which a lost corner is searched for.

    Yields:
        For each image the ids (k,) and the indices of their corners (k,).
    """
    corners = seen.shape[1]
    ids = np.full(corners, -1, dtype=np.int64)
    last_s = np.full(corners, -np.inf)
    tracked = np.zeros(corners, dtype=bool)
    next_id = 1
    for now_s, visible in zip(time_s, seen, strict=True):
        ids[now_s - last_s > reacquire_s] = -1
        tracked &= visible
        for candidates in (visible & ~tracked & (ids >= 0), visible & ~tracked & (ids < 0)):
            free = features - int(tracked.sum())
            if free > 0:
                tracked[np.flatnonzero(candidates)[:free]] = True
        chosen = np.flatnonzero(tracked)
        for corner in chosen[ids[chosen] < 0]:
            ids[corner] = next_id
            next_id += 1
        last_s[chosen] = now_s
        yield ids[chosen], chosen
