"""Texture of a simulated ceiling: brightness on planes, from panels and lamps to stains and plaster.

Shapes are drawn with hard edges on a grid finer than the pixels of the camera; then the whole plane is
blurred by a Gaussian about one pixel wide. An image sampled from it therefore has no aliasing, and a
point of the texture is imaged exactly where geometry projects it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array

LEVELS_PER_GREY = 64
"""Number of brightness steps per grey level. The range is up to 1023 grey levels: lamps saturate the
camera."""
OPAQUE = 65535


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
    """(rows, columns) up to `OPAQUE`; None for an opaque plane that repeats periodically."""


def ceiling_layers(
    rng: np.random.Generator, height_m: float, texel_m: float, *, size_m: float = 12.0, objects: int = 8
) -> tuple[Layer, ...]:
    """Draw a ceiling and the objects that hang below it, from high to low.

    Args:
        rng: generator of the whole texture.
        height_m: height of the ceiling above the floor.
        texel_m: about a third of a pixel seen from the floor.
        size_m: period of the ceiling in both directions.
        objects: number of beams, hanging lamps and pipes below the ceiling.
    """
    half = 0.5 * size_m
    ceiling = Layer(height_m, (-half, -half), texel_m, _ceiling(rng, size_m, texel_m))
    heights = np.sort(rng.uniform(0.08, 0.30, objects) * height_m)
    hanging = [
        _hanging_layer(rng, height_m - drop, texel_m * (1.0 - drop / height_m), rng.uniform(-half, half, 2))
        for drop in heights
    ]
    return (ceiling, *hanging)


def _ceiling(rng: np.random.Generator, size_m: float, texel_m: float) -> NDArray[np.uint16]:
    canvas = _Canvas(size_m, size_m, texel_m, brightness=rng.uniform(120.0, 150.0))
    canvas.add_plaster(rng, grain=3.0, waves=12, wave_grey=1.5)
    cells = round(size_m / rng.choice([0.6, 0.625, 0.75]))
    pitch = size_m / cells
    for line in range(cells):
        for angle in (0.0, np.pi / 2):
            along = (0.0, line * pitch) if angle == 0.0 else (line * pitch, 0.0)
            canvas.rectangle(along, (2.0 * size_m, 0.012), angle, -25.0)
    for cell in np.argwhere(rng.random((cells, cells)) < 0.15):
        canvas.rectangle((cell + 0.5) * pitch, (pitch, pitch), 0.0, rng.uniform(-9.0, 9.0))
    _lamps(rng, canvas, cells, pitch)
    area = size_m * size_m
    for _ in range(round(0.10 * area)):
        _vent(rng, canvas, (rng.integers(cells, size=2) + 0.5) * pitch, 0.8 * pitch)
    for _ in range(round(0.5 * area)):  # smoke detectors, sprinklers, screws
        canvas.disc(rng.uniform(0.0, size_m, 2), rng.uniform(0.02, 0.06), rng.choice([-60.0, -35.0, 40.0]))
    for _ in range(round(0.3 * area)):  # stickers, patches, marks
        size = rng.uniform(0.04, 0.25, 2)
        canvas.rectangle(rng.uniform(0.0, size_m, 2), size, rng.uniform(0.0, np.pi), rng.uniform(-45.0, 45.0))
    for _ in range(round(0.1 * area)):  # water stains
        centre = rng.uniform(0.0, size_m, 2)
        for _ in range(6):
            canvas.disc(centre + rng.normal(0.0, 0.08, 2), rng.uniform(0.03, 0.10), -6.0)
    return canvas.blurred()


def _lamps(rng: np.random.Generator, canvas: _Canvas, cells: int, pitch: float) -> None:
    """Draw identical luminaires at regular distances, as in an office or a corridor."""
    step = rng.integers(3, 5, 2)
    length, width = (0.95 * pitch, 0.95 * pitch) if rng.random() < 0.5 else (2.0 * pitch, 0.16)
    for row in range(0, cells - 1, int(step[0])):
        for column in range(0, cells - 1, int(step[1])):
            centre = (np.array([column, row]) + 0.5) * pitch
            lit = rng.random() < 0.7
            canvas.rectangle(centre, (length + 0.05, width + 0.05), 0.0, -40.0)
            canvas.rectangle(centre, (length, width), 0.0, 300.0 if lit else 75.0)


def _vent(rng: np.random.Generator, canvas: _Canvas, centre: Array, side: float) -> None:
    canvas.rectangle(centre, (side, side), 0.0, 25.0)
    turned = float(rng.choice([0.0, np.pi / 2]))
    for offset in np.linspace(-0.4, 0.4, 7) * side:
        shift = (0.0, offset) if turned == 0.0 else (offset, 0.0)
        canvas.rectangle(centre + shift, (0.85 * side, 0.03), turned, -70.0)


def _hanging_layer(rng: np.random.Generator, height_m: float, texel_m: float, centre: Array) -> Layer:
    """Draw a beam, a soffit or a lamp below the ceiling, with its own marks."""
    long_side, short_side = rng.uniform(0.5, 2.0), rng.uniform(0.15, 0.5)
    width, height = (long_side, short_side) if rng.random() < 0.5 else (short_side, long_side)
    margin = 24.0 * texel_m
    middle = (0.5 * width + margin, 0.5 * height + margin)
    shape = _Canvas(width + 2.0 * margin, height + 2.0 * margin, texel_m, brightness=0.0)
    shape.rectangle(middle, (width, height), 0.0, 1.0)
    mask = shape.texels.copy()
    marks = _Canvas(width + 2.0 * margin, height + 2.0 * margin, texel_m, brightness=rng.uniform(70.0, 200.0))
    marks.add_plaster(rng, grain=3.0, waves=0, wave_grey=0.0)
    for _ in range(round(15 * width * height) + 2):
        place = margin + rng.uniform(0.1, 0.9, 2) * (width, height)
        marks.rectangle(place, rng.uniform(0.03, 0.10, 2), rng.uniform(0.0, np.pi), rng.uniform(-60.0, 60.0))
    marks.texels *= mask
    origin = (float(centre[0] - middle[0]), float(centre[1] - middle[1]))
    return Layer(height_m, origin, texel_m, marks.blurred(), shape.blurred(OPAQUE))


class _Canvas:
    """A periodic rectangle of the world to draw on."""

    def __init__(self, width_m: float, height_m: float, texel_m: float, *, brightness: float) -> None:
        self._texel_m = texel_m
        shape = (round(height_m / texel_m), round(width_m / texel_m))
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
        self.texels += grain * rng.standard_normal(self.texels.shape, dtype=np.float32)
        rows, columns = self.texels.shape
        periods = rng.integers(-8, 9, (2, waves)) * 2.0 * np.pi
        x = np.outer(np.arange(columns) / columns, periods[0]) + rng.uniform(0.0, 2.0 * np.pi, waves)
        y = np.outer(np.arange(rows) / rows, periods[1])
        wave = np.cos(y) @ np.cos(x).T - np.sin(y) @ np.sin(x).T  # cos(x + y) of every wave, summed
        self.texels += (wave_grey * wave).astype(np.float32)

    def blurred(self, scale: int = LEVELS_PER_GREY, blur_texels: float = 2.4) -> NDArray[np.uint16]:
        """Return the stored texels, blurred so that three texels per pixel are sufficient."""
        rows, columns = self.texels.shape
        spectrum = np.fft.rfft2(self.texels)
        spectrum *= np.exp(-2.0 * (np.pi * blur_texels * np.fft.fftfreq(rows)[:, None]) ** 2)
        spectrum *= np.exp(-2.0 * (np.pi * blur_texels * np.fft.rfftfreq(columns)) ** 2)
        blurred = np.fft.irfft2(spectrum, self.texels.shape)
        return np.rint(np.clip(scale * blurred, 0.0, 65535.0)).astype(np.uint16)

    def _around(
        self, centre_m: Array | tuple[float, float], reach_m: Array
    ) -> tuple[Array, Array, tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return offsets x (1, n), y (m, 1) from the centre and the indices of their texels."""
        rows, columns = self.texels.shape
        first = np.ceil((np.asarray(centre_m) - reach_m) / self._texel_m).astype(int)
        last = np.floor((np.asarray(centre_m) + reach_m) / self._texel_m).astype(int)
        last = np.minimum(last, first + [columns - 1, rows - 1])
        column, row = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
        x = (column * self._texel_m - centre_m[0])[None, :]
        y = (row * self._texel_m - centre_m[1])[:, None]
        return x, y, (row[:, None] % rows, column[None, :] % columns)
