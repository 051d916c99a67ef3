"""Layers of a simulated ceiling, and the canvas on which their brightness is drawn.

Shapes are drawn with hard edges on a grid finer than the pixels of the camera; then the whole plane is
blurred by a Gaussian about one pixel wide. An image sampled from it therefore has no aliasing, and a
point of the texture is imaged exactly where geometry projects it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array

LEVELS_PER_GREY = 64
"""Number of brightness steps per grey level. The range is up to 1023 grey levels: lamps saturate the
camera."""
OPAQUE = 65535
_REACH = 5.0
"""Standard deviations of a blur beyond which it is zero."""

Motion = Callable[[float], tuple[float, float, float]]
"""Function from a time (s) to a displacement in x and y (m) and a rotation about the centre (rad)."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Resolution of a texture."""

    texel_m: float
    """Size of a texel: about a third of a pixel seen from the floor."""
    blur_texels: float = 2.4
    """Standard deviation of the blur; with this one three texels per pixel are sufficient. 0 for aliasing."""

    def scaled(self, factor: float) -> Grid:
        """Return the grid with texels larger by a factor."""
        return replace(self, texel_m=self.texel_m * factor)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A horizontal plane, infinite or bounded, with its brightness."""

    height_m: float
    """Height in the world."""
    origin_m: tuple[float, float]
    """World x, y of the centre of the first texel; columns run along x, rows along y."""
    texel_m: float
    brightness: NDArray[np.uint16]
    """(rows, columns) in units of `LEVELS_PER_GREY`; already multiplied by the opacity."""
    opacity: NDArray[np.uint16] | None = None
    """(rows, columns) up to `OPAQUE`; None for an opaque plane that repeats periodically. Where it is 0, the
    brightness is added to that of the layers above: it is light."""
    motion: Motion | None = None
    """Motion of the layer; None if it is fixed."""


class Canvas:
    """A periodic rectangle of the world to draw on."""

    def __init__(self, width_m: float, height_m: float, grid: Grid, *, brightness: float) -> None:
        self.grid = grid
        self.size_m = np.array([width_m, height_m])
        shape = (round(height_m / grid.texel_m), round(width_m / grid.texel_m))
        self.texels = np.full(shape, brightness, dtype=np.float32)

    def rectangle(
        self,
        centre_m: Array | tuple[float, float],
        size_m: Array | tuple[float, float],
        angle: float,
        grey: float,
    ) -> None:
        """Add `grey` on a rectangle rotated by `angle` (rad)."""
        c, s = abs(np.cos(angle)), abs(np.sin(angle))
        reach = 0.5 * np.array([c * size_m[0] + s * size_m[1], s * size_m[0] + c * size_m[1]])
        x, y, part = self._around(centre_m, reach)
        along = np.cos(angle) * x + np.sin(angle) * y
        across = np.cos(angle) * y - np.sin(angle) * x
        self.texels[part] += grey * ((np.abs(along) <= 0.5 * size_m[0]) & (np.abs(across) <= 0.5 * size_m[1]))

    def disc(self, centre_m: Array | tuple[float, float], radius_m: float, grey: float) -> None:
        """Add `grey` on a disc."""
        x, y, part = self._around(centre_m, np.full(2, radius_m))
        self.texels[part] += grey * (x * x + y * y <= radius_m * radius_m)

    def add_plaster(self, rng: np.random.Generator, *, grain: float, waves: int, wave_grey: float) -> None:
        """Add plaster (grain of each texel) and slow variations of brightness."""
        self.texels += np.float32(grain) * rng.standard_normal(self.texels.shape, dtype=np.float32)
        rows, columns = self.texels.shape
        periods = rng.integers(-8, 9, (2, waves)) * 2.0 * np.pi
        x = np.outer(np.arange(columns) / columns, periods[0]) + rng.uniform(0.0, 2.0 * np.pi, waves)
        y = np.outer(np.arange(rows) / rows, periods[1])
        by_row = wave_grey * np.concatenate([np.cos(y), -np.sin(y)], axis=1)
        by_column = np.concatenate([np.cos(x), np.sin(x)], axis=1)
        # cos(x + y) of every wave, summed; in single precision, as the texels are
        self.texels += by_row.astype(np.float32) @ by_column.astype(np.float32).T

    def blurred(self, scale: int = LEVELS_PER_GREY) -> NDArray[np.uint16]:
        """Return the stored texels, blurred as the grid says."""
        blurred = self._convolved(self.grid.blur_texels) if self.grid.blur_texels > 0.0 else self.texels
        scaled = np.float32(scale) * blurred
        return np.rint(np.clip(scaled, 0.0, 65535.0, out=scaled), out=scaled).astype(np.uint16)

    def _convolved(self, blur_texels: float) -> NDArray[np.float32]:
        """Return the texels convolved with a Gaussian, periodically."""
        reach = math.ceil(_REACH * blur_texels)
        wide = np.pad(self.texels, reach, mode='wrap')
        blurred = cv2.GaussianBlur(wide, (2 * reach + 1,) * 2, blur_texels)
        return np.asarray(blurred[reach:-reach, reach:-reach], np.float32)

    def _around(
        self, centre_m: Array | tuple[float, float], reach_m: Array
    ) -> tuple[Array, Array, tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return offsets x (1, n), y (m, 1) from the centre and the indices of their texels."""
        rows, columns = self.texels.shape
        first = np.ceil((np.asarray(centre_m) - reach_m) / self.grid.texel_m).astype(int)
        last = np.floor((np.asarray(centre_m) + reach_m) / self.grid.texel_m).astype(int)
        last = np.minimum(last, first + [columns - 1, rows - 1])
        column, row = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
        x = (column * self.grid.texel_m - centre_m[0])[None, :]
        y = (row * self.grid.texel_m - centre_m[1])[:, None]
        return x, y, (row[:, None] % rows, column[None, :] % columns)


def cut_out(height_m: float, centre_m: Array, marks: Canvas, outline: Canvas) -> Layer:
    """Return the layer of an object below the ceiling.

    Args:
        height_m: height of the layer in the world.
        centre_m: (2,) world position of its centre.
        marks: brightness of the object; it is drawn on.
        outline: 1 on the object, 0 elsewhere.
    """
    marks.texels *= outline.texels
    x, y = centre_m - 0.5 * marks.size_m
    texel_m = marks.grid.texel_m
    return Layer(height_m, (float(x), float(y)), texel_m, marks.blurred(), outline.blurred(OPAQUE))
