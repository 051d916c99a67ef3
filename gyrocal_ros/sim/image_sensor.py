"""The image sensor behind the lens: vignetting and dust, gain, noise and grey levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.sim.canvas import LEVELS_PER_GREY
from gyrocal_ros.sim.image_conditions import ImageConditions
from gyrocal_ros.sim.sensors import stream

SPECK_RADIUS_PX, SPECK_LOSS = (4.0, 14.0), (0.1, 0.5)
"""Ranges of the radius of a speck of dust, which is out of focus, and of its loss of light."""
SHOT_GREY = 100.0
"""Grey level at which `shot_noise_grey` holds."""


class ImageSensor:
    """Converts light to grey levels.

    Args:
        camera: intrinsics, for the size of the image.
        conditions: vignetting, dust and noise.
        seed: seed of the dust.
    """

    def __init__(
        self,
        camera: CameraIntrinsics,
        conditions: ImageConditions,
        seed: int = 0,
    ) -> None:
        self._conditions = conditions
        v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        middle = 0.5 * np.array([camera.width_px - 1, camera.height_px - 1])
        radius = np.linalg.norm(pixels - middle, axis=1).reshape(u.shape) / np.linalg.norm(middle)
        transmission = 1.0 - conditions.vignetting * radius**2
        if conditions.dust:
            transmission *= _dust(pixels, conditions.dust, stream(seed, 'dust')).reshape(u.shape)
        self._transmission = (transmission / LEVELS_PER_GREY).astype(np.float32)

    def read(
        self,
        light: NDArray[np.float32],
        exposure: float | Array,
        gain: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """Return the grey levels (height, width) of an exposure.

        Args:
            light: (height, width) in units of `LEVELS_PER_GREY`; it is overwritten.
            exposure: factor of the light, gain included; an array (height, 1) has one factor per row.
            gain: gain that amplifies the noise.
            rng: generator of the noise; None for no noise.
        """
        light *= self._transmission * np.asarray(exposure, np.float32)
        if rng is not None:
            light += self._noise_std(light, gain) * rng.standard_normal(light.shape, dtype=np.float32)
        return np.clip(np.rint(light, out=light), 0.0, 255.0, out=light).astype(np.uint8)

    def _noise_std(self, grey: NDArray[np.float32], gain: float) -> np.float32 | NDArray[np.float32]:
        read, shot = gain * self._conditions.read_noise_grey, self._conditions.shot_noise_grey
        if shot == 0.0:
            return np.float32(read)
        return np.sqrt(np.float32(read**2) + np.float32(gain * shot**2 / SHOT_GREY) * grey)


def _dust(pixels: Array, specks: int, rng: np.random.Generator) -> Array:
    """Draw the transmission (n,) of a dusty lens at pixels (n, 2)."""
    transmission = np.ones(len(pixels))
    centres = rng.uniform([0.0, 0.0], pixels.max(axis=0), (specks, 2))
    for centre, radius in zip(centres, rng.uniform(*SPECK_RADIUS_PX, specks), strict=True):
        distance = np.linalg.norm(pixels - centre, axis=1)
        transmission *= 1.0 - rng.uniform(*SPECK_LOSS) * np.clip(1.5 * (1.0 - distance / radius), 0.0, 1.0)
    return transmission
