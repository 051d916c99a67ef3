"""Rendering of ceiling images: lens, parallax, motion blur, rolling shutter, moving layers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import bearing, bearing_jacobian
from gyrocal_ros.sim.canvas import OPAQUE, Grid, Layer
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.image_sensor import ImageSensor
from gyrocal_ros.sim.texture import ceiling_layers

TEXELS_PER_PIXEL = 3.0
"""Texture resolution. OpenCV rounds positions to 1/32 texel; this many texels reduce it to 0.01 pixel,
which does not accumulate."""
BLOCK_PX = 80
"""Side of the blocks of the image that are rendered one after the other."""
_OUTLINE = 3
"""Number of points along each side of a block by which the part of a layer that it sees is bounded."""
_BEND_PX = 16.0
"""Distance by which a block of a distorting lens may exceed the bounds of these points."""
_SHARP_OCTAVES = 0.25
"""Ratio of texels per pixel to `TEXELS_PER_PIXEL`, in octaves, up to which the texture is not reduced."""


class CameraPose(NamedTuple):
    """Pose of a camera at a time."""

    R_wc: Array
    """(3, 3) attitude, from the optical frame to the world."""
    p_wc: Array
    """(3,) m, position in the world."""
    time_s: float = 0.0


Sweep = Sequence[CameraPose]
"""Poses at the upper and lower edges of the rows of blocks (`block_edges`); or one for all rows."""


class _Block(NamedTuple):
    """A part of the image."""

    part: tuple[slice, slice]
    row: int
    """Number of its row of blocks."""
    rays: NDArray[np.float32]
    """(rows, columns, 2)"""
    levels: list[tuple[int, NDArray[np.float32]]]
    """Levels of the texture that it sees, 0 for the full resolution, and their weights (rows, columns)."""


class _Plane(NamedTuple):
    """A layer, and its textures (rows, columns) at full, half, ... resolution."""

    layer: Layer
    brightness: list[NDArray[np.uint16]]
    opacity: list[NDArray[np.uint16]] | None


class CeilingRenderer:
    """Renders the images of a camera below a ceiling.

    Args:
        camera: its intrinsics.
        layers: visible planes, from high to low.
        sensor: the image sensor; by default one under normal conditions.
        optical_blur_px: standard deviation of the blur of the lens.
    """

    def __init__(
        self,
        camera: CameraIntrinsics,
        layers: Sequence[Layer],
        sensor: ImageSensor | None = None,
        *,
        optical_blur_px: float = 0.0,
    ) -> None:
        self._sensor = sensor or ImageSensor(camera, ImageConditions())
        self._optical_blur_px = optical_blur_px
        self._shape = (camera.height_px, camera.width_px)
        self._blocks = _blocks(camera)
        self._outlines = np.stack([_outline(block.rays) for block in self._blocks])
        top_levels = np.array([max(level for level, _ in block.levels) for block in self._blocks])
        self._reach = _BEND_PX * TEXELS_PER_PIXEL * 2.0 ** top_levels[:, None]
        self._planes = [_plane(layer, 1 + int(top_levels.max())) for layer in layers]

    def render(
        self,
        R_wc: Array,
        p_wc: Array,
        *,
        exposure: float = 1.0,
        blur: Sequence[tuple[Array, Array]] = (),
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """Render one image of a global shutter.

        Args:
            R_wc: (3, 3) attitude, from the optical frame to the world.
            p_wc: (3,) m, position in the world.
            exposure: brightness relative to the normal one.
            blur: attitudes and positions at equal steps of the exposure time, which are averaged; if
                empty, the camera is static at `R_wc`, `p_wc`.
            rng: generator of the read noise; None for no noise.

        Returns:
            (height, width) grey values.
        """
        return self.expose([[CameraPose(*pose)] for pose in blur or [(R_wc, p_wc)]], exposure, rng=rng)

    def expose(
        self,
        sweeps: Sequence[Sweep],
        exposure: float | Array,
        *,
        gain: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """Render one image.

        Args:
            sweeps: the poses at equal steps of the exposure time, which are averaged.
            exposure: brightness relative to the normal one, gain included; (height, 1) has one per row.
            gain: gain of the sensor, which amplifies the noise.
            rng: generator of the noise; None for no noise.

        Returns:
            (height, width) grey values.
        """
        light = self._sharp(sweeps[0])
        for sweep in sweeps[1:]:
            light += self._sharp(sweep)
        if self._optical_blur_px > 0.0:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), self._optical_blur_px), np.float32)
        return self._sensor.read(light, exposure / len(sweeps), gain, rng)

    def _sharp(self, sweep: Sweep) -> NDArray[np.float32]:
        """Return the light (height, width) in one sweep over the rows."""
        image = np.zeros(self._shape, dtype=np.float32)
        for plane in self._planes:
            to_texels = [_rays_to_texels(plane.layer, pose) for pose in sweep]
            for number, shift in self._covered(plane.layer, to_texels):
                block = self._blocks[number]
                edges = to_texels[block.row : block.row + 2] if len(sweep) > 1 else to_texels
                _draw(plane, block, shift @ edges[0], shift @ edges[-1], image[block.part])
        return image

    def _covered(self, layer: Layer, to_texels: Sequence[Array]) -> Iterator[tuple[int, Array]]:
        """Yield the blocks in which a layer may be in view: number, and shift (3, 3) by whole periods.

        A repeating layer is shifted where a block sees nothing of its first period, because OpenCV is slow
        beyond the edge of a texture.
        """
        texels = np.concatenate(
            [cv2.perspectiveTransform(self._outlines, edge) for edge in to_texels], axis=1
        )
        low, high = texels.min(axis=1), texels.max(axis=1)
        size = np.array(layer.brightness.shape[::-1])
        if layer.opacity is None:
            periods = np.where((high < 0.0) | (low >= size), np.floor(0.5 * (low + high) / size), 0.0)
            yield from enumerate(_shifts(-periods * size))
            return
        near = (high > -self._reach) & (low < size + self._reach)
        for number in np.flatnonzero(near.all(axis=1)).tolist():
            yield number, np.eye(3)


def block_edges(height_px: int) -> Array:
    """Return the rows (n + 1,) that divide an image into n rows of blocks, in pixels."""
    return np.round(np.linspace(0, height_px, 1 + math.ceil(height_px / BLOCK_PX)))


def _blocks(camera: CameraIntrinsics) -> list[_Block]:
    """Divide an image into blocks."""
    v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
    rays = bearing(camera, np.stack([u, v], axis=-1).reshape(-1, 2))
    octaves = _octaves(camera, rays).astype(np.float32).reshape(u.shape)
    rays = rays.astype(np.float32).reshape(*u.shape, 2)
    blocks = []
    for row, rows in enumerate(_slices(camera.height_px)):
        for columns in _slices(camera.width_px):
            inside = octaves[rows, columns]
            levels = range(int(inside.min()), 1 + math.ceil(inside.max()))
            weights = [(level, np.maximum(1.0 - np.abs(inside - level), 0.0)) for level in levels]
            part = np.ascontiguousarray(rays[rows, columns])
            blocks.append(_Block((rows, columns), row, part, weights))
    return blocks


def _slices(size_px: int) -> list[slice]:
    edges = block_edges(size_px).astype(int).tolist()
    return [slice(start, stop) for start, stop in zip(edges[:-1], edges[1:], strict=True)]


def _outline(rays: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return some rays of a block (m, 2), its corners included."""
    rows, columns = (np.linspace(0, size - 1, _OUTLINE).round().astype(int) for size in rays.shape[:2])
    return np.ascontiguousarray(rays[rows[:, None], columns]).reshape(-1, 2)


def _positions(rays: NDArray[np.float32], first: Array, last: Array) -> NDArray[np.float32]:
    """Return texels (rows, columns, 2), interpolated between homographies at the upper and lower edges."""
    upper = np.asarray(cv2.perspectiveTransform(rays, first), np.float32)
    if np.array_equal(first, last):
        return upper
    lower = np.asarray(cv2.perspectiveTransform(rays, last), np.float32)
    share = ((np.arange(len(rays)) + 0.5) / len(rays)).astype(np.float32)
    return upper + share[:, None, None] * (lower - upper)


def _draw(plane: _Plane, block: _Block, first: Array, last: Array, light: NDArray[np.float32]) -> None:
    """Draw a layer on the light (rows, columns) of a block.

    Args:
        plane: the layer.
        block: the block.
        first: homography from rays to texels at the upper edge.
        last: the same at the lower edge.
        light: light from the layers above, which is replaced.
    """
    border = cv2.BORDER_WRAP if plane.opacity is None else cv2.BORDER_CONSTANT
    positions = [
        _positions(block.rays, *(_reduction(plane, level) @ edge for edge in (first, last)))
        for level, _ in block.levels
    ]
    brightness = _sampled(plane.brightness, block, positions, border)
    if plane.opacity is None:
        light[:] = brightness
        return
    light *= 1.0 - _sampled(plane.opacity, block, positions, border) / np.float32(OPAQUE)
    light += brightness


def _shifts(texels: Array) -> Array:
    """Return the transforms (n, 3, 3) of columns and rows that shift them by texels (n, 2)."""
    shifts = np.tile(np.eye(3), (len(texels), 1, 1))
    shifts[:, :2, 2] = texels
    return shifts


def _sampled(
    pyramid: list[NDArray[np.uint16]], block: _Block, positions: list[NDArray[np.float32]], border: int
) -> NDArray[np.float32]:
    """Return interpolated texels (rows, columns) of a block; with a constant border zero beyond the edge.

    Args:
        pyramid: texture by level.
        block: the block.
        positions: texels (rows, columns, 2) of each level of the block.
        border: OpenCV's name of what is beyond the edge.
    """
    samples = [
        np.asarray(cv2.remap(pyramid[level], at, None, cv2.INTER_LINEAR, borderMode=border), np.float32)  # type: ignore[call-overload]
        for (level, _), at in zip(block.levels, positions, strict=True)
    ]
    if len(samples) == 1:
        return samples[0]
    weighted = (weight * sample for (_, weight), sample in zip(block.levels, samples, strict=True))
    return np.asarray(sum(weighted), np.float32)


def _plane(layer: Layer, levels: int) -> _Plane:
    opacity = None if layer.opacity is None else _pyramid(layer.opacity, levels)
    return _Plane(layer, _pyramid(layer.brightness, levels), opacity)


def _pyramid(texels: NDArray[np.uint16], levels: int) -> list[NDArray[np.uint16]]:
    """Return a texture at full, half, ... resolution."""
    rows, columns = texels.shape
    sizes = [(max(columns >> level, 1), max(rows >> level, 1)) for level in range(1, levels)]
    reduced = [cv2.resize(texels, size, interpolation=cv2.INTER_AREA) for size in sizes]
    return [texels, *(np.asarray(level, np.uint16) for level in reduced)]


def _reduction(plane: _Plane, level: int) -> Array:
    """Return the transform (3, 3) from columns and rows of a texture to those of one of its levels."""
    if level == 0:
        return np.eye(3)
    x, y = np.array(plane.brightness[level].shape[::-1]) / np.array(plane.brightness[0].shape[::-1])
    return np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])


def _octaves(camera: CameraIntrinsics, rays: Array) -> Array:
    """Return by how many octaves (n,) the texture has to be reduced at rays (n, 2)."""
    area = np.linalg.det(bearing_jacobian(camera, rays)) * camera.fx_px * camera.fy_px
    return np.maximum(0.5 * np.log2(np.maximum(area, 1.0)) - _SHARP_OCTAVES, 0.0)


def _rays_to_texels(layer: Layer, pose: CameraPose) -> Array:
    """Return the homography (3, 3) from normalised image coordinates to columns and rows of a layer."""
    R_wc, p_wc = pose.R_wc, pose.p_wc
    distance = layer.height_m - p_wc[2]
    to_plane = np.array(
        [
            [distance, 0.0, p_wc[0] - layer.origin_m[0]],
            [0.0, distance, p_wc[1] - layer.origin_m[1]],
            [0.0, 0.0, layer.texel_m],
        ]
    )
    to_texels = to_plane @ R_wc / layer.texel_m
    return to_texels if layer.motion is None else _motion_undone(layer, pose.time_s) @ to_texels


def _motion_undone(layer: Layer, time_s: float) -> Array:
    """Return the transform (3, 3) from columns and rows of a layer at rest to those of the moved one."""
    assert layer.motion is not None
    x, y, angle = layer.motion(time_s)
    c, s = math.cos(angle), math.sin(angle)
    middle = 0.5 * np.array(layer.brightness.shape[::-1])
    turn = np.array([[c, s], [-s, c]])
    shift = middle - turn @ (middle + np.array([x, y]) / layer.texel_m)
    return np.block([[turn, shift[:, None]], [np.array([[0.0, 0.0, 1.0]])]])


def texture_grid(camera: CameraIntrinsics, ceiling_height_m: float) -> Grid:
    """Return the resolution of a ceiling for a camera near the floor."""
    return Grid(ceiling_height_m / (TEXELS_PER_PIXEL * math.sqrt(camera.fx_px * camera.fy_px)))


def ceiling_renderer(
    camera: CameraIntrinsics, seed: int, *, ceiling_height_m: float = 2.5, objects: int = 8
) -> CeilingRenderer:
    """Return a renderer for a camera near the floor below a random default ceiling."""
    grid = texture_grid(camera, ceiling_height_m)
    layers = ceiling_layers(np.random.default_rng(seed), ceiling_height_m, grid, objects=objects)
    return CeilingRenderer(camera, layers)
