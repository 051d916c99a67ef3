"""The room: corners on the ceiling, furniture that hides it, and a tracker that follows the corners."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, CameraIntrinsics, IntArray
from gyrocal_ros.model.camera import in_image, project


@dataclass(frozen=True, slots=True)
class Furniture:
    """A table or a bed: a level board that the robot drives under."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    height_m: float = 0.45
    """Of the board's underside above the floor."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What the camera can see."""

    points_w: Array
    """(m, 3) corners, strongest first: a tracker takes them in this order."""
    furniture: tuple[Furniture, ...] = ()


def draw_scene(
    rng: np.random.Generator,
    room_m: tuple[float, float],
    camera_height_m: float,
    furniture: tuple[Furniture, ...] = (),
    corners: int = 60,
    lamps: int = 8,
) -> Scene:
    """Scatter corners over a ceiling of several levels, and a few lower ones on lamps and shelves.

    Args:
        rng: the scene's own random stream.
        room_m: length and width, around the origin.
        camera_height_m: above the floor.
        furniture: what hides the ceiling.
        corners: on the ceiling, 2.0 to 2.7 m above the camera.
        lamps: corners 1.2 to 2.0 m above the camera.
    """
    count = corners + lamps
    half = np.array(room_m) / 2.0
    level = rng.uniform(-half, half, (count, 2))
    height = np.where(
        rng.permutation(count) < lamps, rng.uniform(1.2, 2.0, count), rng.uniform(2.0, 2.7, count)
    )
    return Scene(np.column_stack([level, camera_height_m + height]), furniture)


def occluded(furniture: tuple[Furniture, ...], camera_w: Array, points_w: Array) -> np.ndarray:
    """Which of the points (m, 3) a board hides from the camera at each place (n, 3): (n, m) bool."""
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
        (n, m, 2) raw pixels, and (n, m) which of them can be seen.
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
    """Follow corners as a tracker does: each until it is lost, and a new one in its place.

    A corner that comes back soon enough keeps its id; after that its id is dropped for good.

    Args:
        seen: (n, m) which corners can be tracked in each image.
        time_s: (n,) of the images.
        features: how many are tracked at a time.
        reacquire_s: how long a lost corner is looked for.

    Yields:
        For each image the ids (k,) and the corners (k,) they stand for.
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
