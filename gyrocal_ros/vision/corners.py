"""Detection of new features: Harris corners, distributed over the image."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import TrackerConfig
from gyrocal_ros.data import Array, IntArray

HARRIS_K = 0.04
WINDOW_PX = 14
"""Side of the window of the structure tensor: about that of a patch."""

SATURATED_GREY = 250
JPEG_BLOCK_PX = 8
BLOCK_SHARE = 0.5
"""Share of the squared steps of a patch at edges of JPEG blocks, from which it shows little else. Of other
texture that is an eighth, but by chance more than half in one of 20 patches of sharp cells."""
STEP_RATIO = 1.5
"""Mean step at the edges of blocks, relative to that in their middle, from which an image shows blocks."""
DISTINCT_RADIUS_PX = 16
"""Radius around a corner without similar patches: about the search radius of the tracker."""


def find_corners(
    image: NDArray[np.uint8], taken: Array, marks: IntArray, margin_px: int, config: TrackerConfig
) -> NDArray[np.intp]:
    """Find Harris corners in order of preference.

    The search runs at half the resolution, which reduces noise and motion blur. Parts of the image with
    few features come before parts with stronger corners, because features in all directions determine
    the heading best. Corners of lamps that saturate the image come last: they move as the exposure
    changes.

    Args:
        image: (height, width).
        taken: (n, 2) pixels of features to keep away from.
        marks: (k, 2) pixels of marks on the lens.
        margin_px: minimum distance from the edge of the image.
        config: distances and quality.

    Returns:
        (m, 2) whole pixels u, v.
    """
    half = np.asarray(cv2.pyrDown(image), np.uint8)
    allowed = np.zeros(half.shape, dtype=np.uint8)
    edge = margin_px // 2 + 1
    allowed[edge:-edge, edge:-edge] = 255
    _mask_out(allowed, taken, config.min_distance_px)
    _mask_out(allowed, marks, 2.0 * config.patch_px)
    saturated = cv2.dilate(half, np.ones((WINDOW_PX // 2 + 2,) * 2, np.uint8)) >= SATURATED_GREY
    unsaturated = _harris(half, np.where(saturated, 0, allowed).astype(np.uint8), config)
    corners = unsaturated[_spread_order(unsaturated, taken, image.shape, config.features)]
    if saturated.any():
        _mask_out(allowed, unsaturated, config.min_distance_px)
        bright = _harris(half, np.where(saturated, allowed, 0).astype(np.uint8), config)
        corners = np.concatenate([corners, bright])
    return corners


def _mask_out(allowed: NDArray[np.uint8], pixels: Array | IntArray, radius_px: float) -> None:
    """Exclude the surroundings of pixels (n, 2) of the full image."""
    for u, v in pixels:
        cv2.circle(allowed, (round(0.5 * u), round(0.5 * v)), round(0.5 * radius_px), 0, -1)


def _harris(half: NDArray[np.uint8], allowed: NDArray[np.uint8], config: TrackerConfig) -> NDArray[np.intp]:
    """Return corners (n, 2) in pixels of the full image, strongest first."""
    found = cv2.goodFeaturesToTrack(
        half,
        maxCorners=8 * config.features,
        qualityLevel=config.corner_quality,
        minDistance=0.5 * config.min_distance_px,
        mask=allowed,
        blockSize=WINDOW_PX // 2,
        useHarrisDetector=True,
        k=HARRIS_K,
    )
    return np.zeros((0, 2), np.intp) if found is None else 2 * found.reshape(-1, 2).astype(np.intp)


def recognisable(
    image: NDArray[np.uint8], corners: NDArray[np.intp], size: int, limit: float
) -> Iterator[NDArray[np.intp]]:
    """Yield the corners whose patch will be found again: it shows texture, and no other one near is like it.

    Args:
        image: (height, width).
        corners: (n, 2) whole pixels.
        size: side of a patch in pixels.
        limit: correlation from which two patches are alike.
    """
    looks_for_blocks = shows_blocks(image)
    for corner in corners:
        if looks_for_blocks and is_of_blocks(image, corner, size):
            continue
        if is_distinct(image, corner, size, limit):
            yield corner


def is_distinct(image: NDArray[np.uint8], corner: NDArray[np.intp], size: int, limit: float) -> bool:
    """Return whether no other patch near a corner has a correlation of `limit` or more with its patch.

    This rejects the slats of a grille and points along an edge, which would be mistaken for each other.
    """
    u, v = corner
    half, wide = size // 2, size // 2 + DISTINCT_RADIUS_PX
    top, left = max(0, v - wide), max(0, u - wide)
    patch = image[v - half : v + half + 1, u - half : u + half + 1]
    scores = cv2.matchTemplate(image[top : v + wide + 1, left : u + wide + 1], patch, cv2.TM_CCOEFF_NORMED)
    row, column = v - half - top, u - half - left
    own = size // 4
    scores[max(0, row - own) : row + own + 1, max(0, column - own) : column + own + 1] = -1.0
    return bool(scores.max() < limit)


def shows_blocks(image: NDArray[np.uint8]) -> bool:
    """Return whether the blocks of JPEG show in an image."""
    middle = JPEG_BLOCK_PX // 2
    steps = np.abs(np.diff(image[middle::JPEG_BLOCK_PX].astype(np.int16), axis=1))
    at_edges, inside = (
        float(steps[:, place - 1 :: JPEG_BLOCK_PX].mean()) for place in (JPEG_BLOCK_PX, middle)
    )
    return at_edges > STEP_RATIO * inside


def is_of_blocks(image: NDArray[np.uint8], corner: NDArray[np.intp], size: int) -> bool:
    """Return whether a patch shows hardly more than the blocks of a JPEG image.

    In the dark these are all that is left of a ceiling, and they stay in the image while the camera turns.
    """
    u, v = corner - size // 2
    patch = image[v : v + size, u : u + size].astype(float)
    steps = np.diff(patch, axis=1) ** 2, np.diff(patch, axis=0).T ** 2
    edges = [np.arange(start + 1, start + size) % JPEG_BLOCK_PX == 0 for start in (u, v)]
    at_edges = sum(float(each[:, edge].sum()) for each, edge in zip(steps, edges, strict=True))
    return at_edges > BLOCK_SHARE * sum(float(each.sum()) for each in steps)


def noise_level(image: NDArray[np.uint8]) -> float:
    """Return the standard deviation of the pixel noise in grey levels, from the median second difference."""
    lines = image[::8].astype(np.int16)
    second = np.abs(lines[:, 2:] - 2 * lines[:, 1:-1] + lines[:, :-2])
    return max(0.5, float(np.median(second)) / (0.6745 * 6.0**0.5))


def _spread_order(
    corners: NDArray[np.intp], taken: Array, shape: tuple[int, ...], wanted: int
) -> NDArray[np.intp]:
    """Return the order in which corners fill the image evenly; `corners` are sorted strongest first."""
    side = (shape[0] * shape[1] / max(wanted, 1)) ** 0.5
    cells = [tuple(cell) for cell in np.floor_divide(corners, side).astype(int)]
    filled: dict[tuple[int, ...], int] = {}
    for place in np.floor_divide(taken, side).astype(int):
        filled[tuple(place)] = filled.get(tuple(place), 0) + 1
    rank = np.empty(len(corners), dtype=int)
    for index, cell in enumerate(cells):
        rank[index] = filled[cell] = filled.get(cell, 0) + 1
    return np.argsort(rank, kind='stable')
