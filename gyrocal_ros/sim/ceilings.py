"""The ceilings of the simulator, by name, and a photograph as a ceiling."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.errors import ConfigError, RecordingError, did_you_mean
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY, Canvas, Grid, Layer, cut_out
from gyrocal_ros.sim.moving import sun_patch
from gyrocal_ros.sim.texture import ceiling_layers

PERIOD_M = 9.0
"""Period of the ceilings in both directions."""
TILE_M = 0.6
LENGTH_M = 14.0
"""Length of beams and pipes."""
PHOTOGRAPH_M = 5.0
"""Width of the ceiling that a photograph shows."""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """A kind of ceiling."""

    about: str
    draw: Callable[[np.random.Generator, float, Grid], tuple[Layer, ...]]
    """Function of a generator, the height (m) and the resolution to layers from high to low."""


def find_ceiling(name: str) -> Ceiling:
    """Return the ceiling of that name, or that of a photograph.

    Args:
        name: one of `CEILINGS`, or the file of a photograph.

    Raises:
        ConfigError: there is no such ceiling or file.
    """
    if name in CEILINGS:
        return CEILINGS[name]
    if not Path(name).is_file():
        todo = f'give the file of a photograph, or a name: {did_you_mean(name, list(CEILINGS))}'
        raise ConfigError(f'{name!r} is not a ceiling', where='ceiling', todo=todo)
    return Ceiling('a photograph', lambda rng, height_m, grid: (photograph(Path(name), height_m, grid),))


def photograph(file: Path, height_m: float, grid: Grid) -> Layer:
    """Return a photograph as a ceiling; it is mirrored where it repeats, so that there are no seams.

    Args:
        file: a jpeg or png file.
        height_m: height of the ceiling above the floor.
        grid: resolution; a finer photograph is reduced to it, unless there is aliasing.

    Raises:
        ConfigError: the file is not an image.
    """
    from gyrocal_ros.msgs.images import read_grey_file  # OpenCV is loaded only for photographs

    try:
        grey = read_grey_file(file)
    except RecordingError as error:
        raise ConfigError('is not an image', where=str(file), todo='give a jpeg or png file') from error
    if grid.blur_texels > 0.0:
        grey = _reduced(grey, max(int(grid.texel_m * grey.shape[1] / PHOTOGRAPH_M), 1))
    mirrored = np.block([[grey, grey[:, ::-1]], [grey[::-1], grey[::-1, ::-1]]])
    origin_m = -0.5 * PHOTOGRAPH_M
    texel_m = PHOTOGRAPH_M / grey.shape[1]
    return Layer(height_m, (origin_m, origin_m), texel_m, mirrored.astype(np.uint16) * LEVELS_PER_GREY)


def _reduced(grey: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Return the means of squares of `factor` times `factor` pixels."""
    rows, columns = (size // factor for size in grey.shape)
    squares = grey[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.rint(squares.mean(axis=(1, 3))).astype(np.uint8)


def _tiles(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw mineral-fibre tiles of one pattern, which differ by little more than their brightness."""
    tile = Canvas(TILE_M, TILE_M, grid, brightness=150.0)
    for _ in range(60):
        tile.disc(rng.uniform(0.0, TILE_M, 2), rng.uniform(0.004, 0.012), -35.0)
    for angle in (0.0, np.pi / 2):
        tile.rectangle((0.0, 0.0), (2.0 * TILE_M, 0.015), angle, -30.0)
    count = round(PERIOD_M / TILE_M)
    shades = np.kron(rng.normal(0.0, 1.5, (count, count)), np.ones(tile.texels.shape))
    canvas = Canvas(PERIOD_M, PERIOD_M, grid, brightness=0.0)
    canvas.texels = (np.tile(tile.texels, (count, count)) + shades).astype(np.float32)
    canvas.add_plaster(rng, grain=2.0, waves=0, wave_grey=0.0)
    return (_repeating(canvas, height_m),)


def _plaster(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw plaster with faint shades and marks of a few grey levels."""
    canvas = _plastered(rng, grid, brightness=150.0)
    for centre in _places(rng, 0.5):
        canvas.rectangle(centre, rng.uniform(0.05, 0.4, 2), rng.uniform(0.0, np.pi), rng.uniform(-9.0, 9.0))
    for centre in _places(rng, 0.15):  # hairline cracks
        canvas.rectangle(centre, (rng.uniform(0.2, 0.8), 0.006), rng.uniform(0.0, np.pi), -20.0)
    return (_repeating(canvas, height_m),)


def _beams(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw boards, and below them beams in both directions at two depths, 1.1 m apart."""
    canvas = _plastered(rng, grid, brightness=140.0)
    for y in np.arange(0.0, PERIOD_M, 0.18):
        canvas.rectangle((0.0, y), (2.0 * PERIOD_M, 0.008), 0.0, rng.uniform(-30.0, -15.0))
    _scatter_marks(rng, canvas, 1.0)
    places = 1.1 * np.arange(-6.0, 7.0)
    upper = [_beam(rng, height_m, grid, 0.15, place, along_x=True) for place in places]
    lower = [_beam(rng, height_m, grid, 0.40, place, along_x=False) for place in places]
    return (_repeating(canvas, height_m), *upper, *lower)


def _beam(
    rng: np.random.Generator, height_m: float, grid: Grid, drop_m: float, place_m: float, *, along_x: bool
) -> Layer:
    """Draw a beam with knots and nails."""
    grid, width_m = grid.scaled(1.0 - drop_m / height_m), rng.uniform(0.08, 0.20)
    marks, outline = _bar(width_m, grid, along_x)
    marks.texels += np.float32(rng.uniform(70.0, 100.0))
    for along in rng.uniform(0.0, LENGTH_M, 50):
        across = 0.5 * float(marks.size_m.min()) + rng.uniform(-0.4, 0.4) * width_m
        place = (along, across) if along_x else (across, along)
        marks.disc(np.array(place), rng.uniform(0.008, 0.02), rng.uniform(-40.0, 40.0))
    centre = np.array((0.0, place_m) if along_x else (place_m, 0.0))
    return cut_out(height_m - drop_m, centre, marks, outline)


def _pipes(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw bare concrete, and below it pipes with clamps at three depths."""
    canvas = _plastered(rng, grid, brightness=105.0)
    _scatter_marks(rng, canvas, 1.5)
    pipes = [
        _pipe(rng, height_m, grid, drop_m, place_m)
        for drop_m in (0.12, 0.30, 0.50)
        for place_m in rng.uniform(-3.0, 3.0, 3)
    ]
    return (_repeating(canvas, height_m), *pipes)


def _pipe(rng: np.random.Generator, height_m: float, grid: Grid, drop_m: float, place_m: float) -> Layer:
    """Draw a pipe with clamps, bright in the middle and dark at its edges."""
    width_m = rng.uniform(0.05, 0.16)
    marks, outline = _bar(width_m, grid.scaled(1.0 - drop_m / height_m), along_x=True)
    middle = 0.5 * float(marks.size_m[1])
    for share in np.linspace(1.0, 0.2, 5):
        marks.rectangle((0.0, middle), (2.0 * LENGTH_M, share * width_m), 0.0, 32.0)
    for clamp in np.arange(rng.uniform(0.2, 0.8), LENGTH_M, rng.uniform(0.6, 0.9)):
        marks.rectangle((clamp, middle), (0.03, width_m), 0.0, -30.0)
    return cut_out(height_m - drop_m, np.array([0.0, place_m]), marks, outline)


def _bar(width_m: float, grid: Grid, along_x: bool) -> tuple[Canvas, Canvas]:
    """Return the marks and the outline of a bar that is longer than the room."""
    size = np.array([LENGTH_M, width_m + 48.0 * grid.texel_m])
    shape = np.array([LENGTH_M, width_m])
    size, shape = (size, shape) if along_x else (size[::-1], shape[::-1])
    marks, outline = (Canvas(float(size[0]), float(size[1]), grid, brightness=0.0) for _ in range(2))
    outline.rectangle(0.5 * size, shape - 48.0 * grid.texel_m * (shape == LENGTH_M), 0.0, 1.0)
    return marks, outline


def _lamps(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw lamps that saturate the camera, with the light around them, below a ceiling with few marks."""
    canvas = _plastered(rng, grid, brightness=95.0)
    for line in np.arange(0.0, PERIOD_M, 0.6):
        canvas.rectangle((0.0, line), (2.0 * PERIOD_M, 0.01), 0.0, -12.0)
        canvas.rectangle((line, 0.0), (2.0 * PERIOD_M, 0.01), np.pi / 2, -12.0)
    for x in np.arange(0.75, PERIOD_M, 1.5):
        for y in np.arange(0.75, PERIOD_M, 1.5):
            for radius in (0.55, 0.45, 0.35, 0.3):
                canvas.disc(np.array([x, y]), radius, 14.0)
            canvas.disc(np.array([x, y]), 0.18, 700.0)
    _scatter_marks(rng, canvas, 0.2)
    return (_repeating(canvas, height_m),)


def _skylight(rng: np.random.Generator, height_m: float, grid: Grid) -> tuple[Layer, ...]:
    """Draw windows far brighter than the ceiling, and a patch of sun that moves."""
    canvas = _plastered(rng, grid, brightness=85.0)
    for x, y in ((2.2, 2.6), (6.6, 5.4)):
        canvas.rectangle((x, y), (1.7, 1.1), 0.0, 60.0)
        for pane in (-0.4, 0.4):
            canvas.rectangle((x + pane, y), (0.7, 0.95), 0.0, 800.0)
    _scatter_marks(rng, canvas, 0.6)
    return (_repeating(canvas, height_m), sun_patch(rng, height_m, grid))


def _plastered(rng: np.random.Generator, grid: Grid, *, brightness: float) -> Canvas:
    canvas = Canvas(PERIOD_M, PERIOD_M, grid, brightness=brightness)
    canvas.add_plaster(rng, grain=2.0, waves=12, wave_grey=1.5)
    return canvas


def _scatter_marks(rng: np.random.Generator, canvas: Canvas, per_m2: float) -> None:
    """Draw stickers, stains and screws."""
    for centre in _places(rng, 0.6 * per_m2):
        canvas.rectangle(centre, rng.uniform(0.03, 0.2, 2), rng.uniform(0.0, np.pi), rng.uniform(-40.0, 40.0))
    for centre in _places(rng, 0.4 * per_m2):
        canvas.disc(centre, rng.uniform(0.015, 0.04), rng.choice([-45.0, 35.0]))


def _places(rng: np.random.Generator, per_m2: float) -> Iterator[NDArray[np.float64]]:
    """Yield random points of the ceiling (2,)."""
    return iter(rng.uniform(0.0, PERIOD_M, (round(per_m2 * PERIOD_M**2), 2)))


def _repeating(canvas: Canvas, height_m: float) -> Layer:
    x, y = -0.5 * canvas.size_m
    return Layer(height_m, (float(x), float(y)), canvas.grid.texel_m, canvas.blurred())


CEILINGS = {
    'default': Ceiling('panels with lamps, vents and stains, and objects that hang below', ceiling_layers),
    'tiles': Ceiling('tiles of one pattern', _tiles),
    'plaster': Ceiling('plaster almost without texture', _plaster),
    'beams': Ceiling('beams in both directions at two depths', _beams),
    'pipes': Ceiling('concrete and pipes at three depths', _pipes),
    'lamps': Ceiling('lamps that saturate the camera', _lamps),
    'skylight': Ceiling('bright windows in a dark ceiling, and a moving patch of sun', _skylight),
}
"""The ceilings by name."""
