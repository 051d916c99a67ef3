"""Texture of the default ceiling: panels, lamps, vents, stains, plaster, and objects that hang below."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array
from gyrocal_ros.sim.canvas import Canvas, Grid, Layer, cut_out


def ceiling_layers(
    rng: np.random.Generator, height_m: float, grid: Grid, *, size_m: float = 12.0, objects: int = 8
) -> tuple[Layer, ...]:
    """Draw a ceiling and the objects that hang below it, from high to low.

    Args:
        rng: generator of the whole texture.
        height_m: height of the ceiling above the floor.
        grid: resolution.
        size_m: period of the ceiling in both directions.
        objects: number of beams, hanging lamps and pipes below the ceiling.
    """
    half = 0.5 * size_m
    ceiling = Layer(height_m, (-half, -half), grid.texel_m, _ceiling(rng, size_m, grid))
    heights = np.sort(rng.uniform(0.08, 0.30, objects) * height_m)
    hanging = [
        _hanging_layer(rng, height_m - drop, grid.scaled(1.0 - drop / height_m), rng.uniform(-half, half, 2))
        for drop in heights
    ]
    return (ceiling, *hanging)


def _ceiling(rng: np.random.Generator, size_m: float, grid: Grid) -> NDArray[np.uint16]:
    canvas = Canvas(size_m, size_m, grid, brightness=rng.uniform(120.0, 150.0))
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


def _lamps(rng: np.random.Generator, canvas: Canvas, cells: int, pitch: float) -> None:
    """Draw identical luminaires at regular distances, as in an office or a corridor."""
    step = rng.integers(3, 5, 2)
    length, width = (0.95 * pitch, 0.95 * pitch) if rng.random() < 0.5 else (2.0 * pitch, 0.16)
    for row in range(0, cells - 1, int(step[0])):
        for column in range(0, cells - 1, int(step[1])):
            centre = (np.array([column, row]) + 0.5) * pitch
            lit = rng.random() < 0.7
            canvas.rectangle(centre, (length + 0.05, width + 0.05), 0.0, -40.0)
            canvas.rectangle(centre, (length, width), 0.0, 300.0 if lit else 75.0)


def _vent(rng: np.random.Generator, canvas: Canvas, centre: Array, side: float) -> None:
    canvas.rectangle(centre, (side, side), 0.0, 25.0)
    turned = float(rng.choice([0.0, np.pi / 2]))
    for offset in np.linspace(-0.4, 0.4, 7) * side:
        shift = (0.0, offset) if turned == 0.0 else (offset, 0.0)
        canvas.rectangle(centre + shift, (0.85 * side, 0.03), turned, -70.0)


def _hanging_layer(rng: np.random.Generator, height_m: float, grid: Grid, centre: Array) -> Layer:
    """Draw a beam, a soffit or a lamp below the ceiling, with its own marks."""
    long_side, short_side = rng.uniform(0.5, 2.0), rng.uniform(0.15, 0.5)
    width, height = (long_side, short_side) if rng.random() < 0.5 else (short_side, long_side)
    margin = 24.0 * grid.texel_m
    outline = Canvas(width + 2.0 * margin, height + 2.0 * margin, grid, brightness=0.0)
    outline.rectangle(0.5 * outline.size_m, (width, height), 0.0, 1.0)
    marks = Canvas(width + 2.0 * margin, height + 2.0 * margin, grid, brightness=rng.uniform(70.0, 200.0))
    marks.add_plaster(rng, grain=3.0, waves=0, wave_grey=0.0)
    for _ in range(round(15 * width * height) + 2):
        place = margin + rng.uniform(0.1, 0.9, 2) * (width, height)
        marks.rectangle(place, rng.uniform(0.03, 0.10, 2), rng.uniform(0.0, np.pi), rng.uniform(-60.0, 60.0))
    return cut_out(height_m, centre, marks, outline)
