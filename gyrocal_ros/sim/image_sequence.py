"""The images of a simulated recording: the ceiling as seen by the camera along the trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY, OPAQUE, Canvas, Grid, Layer, cut_out
from gyrocal_ros.sim.ceilings import Ceiling, find_ceiling
from gyrocal_ros.sim.image_conditions import ExposureControl, ImageConditions, flicker, room_light
from gyrocal_ros.sim.image_sensor import ImageSensor
from gyrocal_ros.sim.moving import moving_layers
from gyrocal_ros.sim.render import CameraPose, CeilingRenderer, Sweep, block_edges, texture_grid
from gyrocal_ros.sim.scene import Furniture
from gyrocal_ros.sim.sensors import stream

CEILING_HEIGHT_M = 2.5
_UNDERSIDE_TEXEL_M = 0.01

CameraPoses = Callable[[Array], tuple[Array, Array]]
"""Function from times (n,) to R_wc (n, 3, 3) and p_wc (n, 3)."""


class ImageSequence:
    """Images of a camera below a ceiling, with motion blur, varying brightness and furniture.

    Args:
        camera: true intrinsics.
        ceiling: name of the ceiling, or file of a photograph of one.
        conditions: conditions of the images.
        furniture: furniture that occludes the ceiling.
        seed: seed of the ceiling, the brightness and the noise.
        time_s: (n,) middles of the exposures.
        camera_poses: poses of the camera.
    """

    def __init__(
        self,
        camera: CameraIntrinsics,
        ceiling: str,
        conditions: ImageConditions,
        furniture: tuple[Furniture, ...],
        seed: int,
        time_s: Array,
        camera_poses: CameraPoses,
    ) -> None:
        grid = texture_grid(camera, CEILING_HEIGHT_M)
        if not conditions.antialiased:
            grid = replace(grid, blur_texels=0.0)
        fixed = drawn(find_ceiling(ceiling), seed, grid)
        moving = moving_layers(conditions, stream(seed, 'moving'), CEILING_HEIGHT_M, grid)
        rng = stream(seed, 'undersides')
        undersides = [_marked(rng, item, grid) if item.marks else _underside(item) for item in furniture]
        layers = sorted([*fixed, *moving, *undersides], key=lambda layer: -layer.height_m)
        sensor = ImageSensor(camera, conditions, seed)
        self._renderer = CeilingRenderer(camera, layers, sensor, optical_blur_px=conditions.optical_blur_px)
        self._conditions, self._control = conditions, ExposureControl(conditions)
        self._is_moving = any(layer.motion is not None for layer in layers)
        self._height_px = camera.height_px
        self._noise = stream(seed, 'image noise')
        self._brightness = room_light(conditions, time_s) * brightness(time_s, stream(seed, 'light'))
        self._time_s, self._camera_poses = time_s, camera_poses

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all images in order."""
        return map(self.render, range(len(self._time_s)))

    def render(self, number: int) -> NDArray[np.uint8]:
        """Render one of the images; the noise differs at each call, and automatic exposure follows them."""
        exposure_s, gain = self._control.exposure_s, self._control.gain
        lit = self._brightness[number] * self._flicker(number, exposure_s)
        exposure = lit * (exposure_s / self._conditions.exposure_s) * gain
        sweeps = self._sweeps(float(self._time_s[number]), exposure_s)
        image = self._renderer.expose(sweeps, exposure, gain=gain, rng=self._noise)
        self._control.follow(float(image.mean()))
        return image

    def _sweeps(self, time_s: float, exposure_s: float) -> list[Sweep]:
        """Return the poses over the exposure; a single one where nothing moves."""
        count, readout_s = self._conditions.blur_poses, self._conditions.readout_s
        shutter_s = exposure_s * ((np.arange(count) + 0.5) / count - 0.5)
        edges = block_edges(self._height_px) / self._height_px - 0.5 if readout_s != 0.0 else np.zeros(1)
        moments_s = time_s + shutter_s[:, None] + readout_s * edges
        R_wc, p_wc = self._camera_poses(moments_s.ravel())
        poses = list(map(CameraPose, R_wc, p_wc, moments_s.ravel().tolist()))
        if not self._is_moving and not np.any(R_wc != R_wc[0]) and not np.any(p_wc != p_wc[0]):
            return [poses[:1]]
        return [poses[start : start + len(edges)] for start in range(0, len(poses), len(edges))]

    def _flicker(self, number: int, exposure_s: float) -> Array:
        """Return the brightness of the lamps for each row (height, 1), or for all rows (1, 1)."""
        rows = (np.arange(self._height_px) + 0.5) / self._height_px - 0.5
        delay_s = self._conditions.readout_s * rows if self._conditions.readout_s != 0.0 else np.zeros(1)
        return flicker(self._conditions, self._time_s[number] + delay_s[:, None], exposure_s)


@lru_cache(maxsize=1)
def drawn(ceiling: Ceiling, seed: int, grid: Grid) -> tuple[Layer, ...]:
    """Draw a ceiling, which takes half a second: recordings one after the other below the same one share it.

    A photograph is another ceiling each time that it is found, so it is read again.
    """
    return ceiling.draw(stream(seed, 'ceiling'), CEILING_HEIGHT_M, grid)


def brightness(time_s: Array, rng: np.random.Generator) -> Array:
    """Draw the brightness (n,) at times (n,): clouds, and an exposure control with a lag."""
    periods_s = rng.uniform([60.0, 15.0, 5.0], [120.0, 30.0, 10.0])
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * np.divide.outer(time_s, periods_s) + phases)
    return np.exp(np.einsum('nk,k->n', waves, np.array([0.10, 0.08, 0.04])))


def _marked(rng: np.random.Generator, furniture: Furniture, grid: Grid) -> Layer:
    """Draw an underside with boards, screws and stickers."""
    grid = grid.scaled(furniture.height_m / CEILING_HEIGHT_M)
    low, high = np.transpose([furniture.x_m, furniture.y_m])
    size = high - low + 48.0 * grid.texel_m
    marks, outline = (Canvas(float(size[0]), float(size[1]), grid, brightness=0.0) for _ in range(2))
    outline.rectangle(0.5 * size, high - low, 0.0, 1.0)
    marks.texels += np.float32(60.0)
    marks.add_plaster(rng, grain=2.0, waves=12, wave_grey=1.5)
    for y in np.arange(0.0, size[1], 0.12):
        marks.rectangle((0.0, y), (2.0 * float(size[0]), 0.003), 0.0, -20.0)
    for centre in rng.uniform(0.0, size, (furniture.marks, 2)):
        marks.disc(centre, rng.uniform(0.003, 0.012), rng.choice([-35.0, 35.0]))
    return cut_out(furniture.height_m, 0.5 * (low + high), marks, outline)


def _underside(furniture: Furniture) -> Layer:
    """Return the dark underside of a piece of furniture, surrounded by one transparent texel."""
    (x0, x1), (y0, y1) = furniture.x_m, furniture.y_m
    shape = (round((y1 - y0) / _UNDERSIDE_TEXEL_M) + 2, round((x1 - x0) / _UNDERSIDE_TEXEL_M) + 2)
    opacity = np.zeros(shape, dtype=np.uint16)
    opacity[1:-1, 1:-1] = OPAQUE
    dark = np.where(opacity > 0, 18 * LEVELS_PER_GREY, 0).astype(np.uint16)
    origin = (x0 - 0.5 * _UNDERSIDE_TEXEL_M, y0 - 0.5 * _UNDERSIDE_TEXEL_M)
    return Layer(furniture.height_m, origin, _UNDERSIDE_TEXEL_M, dark, opacity)
