"""The images of a simulated recording: the ceiling as seen by the camera along the trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.sim.render import TEXELS_PER_PIXEL, CeilingRenderer
from gyrocal_ros.sim.scene import Furniture
from gyrocal_ros.sim.sensors import stream
from gyrocal_ros.sim.texture import LEVELS_PER_GREY, OPAQUE, Layer, ceiling_layers

CEILING_HEIGHT_M = 2.5
EXPOSURE_S = 0.008
BLUR_POSES = 5
_UNDERSIDE_TEXEL_M = 0.01

CameraPoses = Callable[[Array], tuple[Array, Array]]
"""Function from times (n,) to R_wc (n, 3, 3) and p_wc (n, 3)."""


class ImageSequence:
    """Images of a camera below a ceiling, with motion blur, varying brightness and dark furniture.

    Args:
        camera: true intrinsics.
        furniture: furniture that occludes the ceiling.
        seed: seed of the ceiling, the brightness and the noise.
        time_s: (n,) middles of the exposures.
        camera_poses: poses of the camera.
    """

    def __init__(
        self,
        camera: CameraIntrinsics,
        furniture: tuple[Furniture, ...],
        seed: int,
        time_s: Array,
        camera_poses: CameraPoses,
    ) -> None:
        texel_m = CEILING_HEIGHT_M / (TEXELS_PER_PIXEL * np.sqrt(camera.fx_px * camera.fy_px))
        ceiling = ceiling_layers(stream(seed, 'ceiling'), CEILING_HEIGHT_M, texel_m)
        undersides = sorted((_underside(item) for item in furniture), key=lambda layer: -layer.height_m)
        self._renderer = CeilingRenderer(camera, (*ceiling, *undersides))
        self._noise = stream(seed, 'image noise')
        self._exposures = brightness(time_s, stream(seed, 'light'))
        self._time_s, self._camera_poses = time_s, camera_poses

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        """Yield all images in order."""
        return map(self.render, range(len(self._time_s)))

    def render(self, number: int) -> NDArray[np.uint8]:
        """Render one of the images; the noise differs at each call."""
        shutter_s = EXPOSURE_S * ((np.arange(BLUR_POSES) + 0.5) / BLUR_POSES - 0.5)
        R_wc, p_wc = self._camera_poses(self._time_s[number] + shutter_s)
        middle = BLUR_POSES // 2
        moving = bool(np.any(R_wc != R_wc[0]) or np.any(p_wc != p_wc[0]))
        blur = list(zip(R_wc, p_wc, strict=True)) if moving else []
        exposure = float(self._exposures[number])
        return self._renderer.render(
            R_wc[middle], p_wc[middle], exposure=exposure, blur=blur, rng=self._noise
        )


def brightness(time_s: Array, rng: np.random.Generator) -> Array:
    """Draw the brightness (n,) at times (n,): clouds, and an exposure control with a lag."""
    periods_s = rng.uniform([60.0, 15.0, 5.0], [120.0, 30.0, 10.0])
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * np.divide.outer(time_s, periods_s) + phases)
    return np.exp(np.einsum('nk,k->n', waves, np.array([0.10, 0.08, 0.04])))


def _underside(furniture: Furniture) -> Layer:
    """Return the dark underside of a piece of furniture, surrounded by one transparent texel."""
    (x0, x1), (y0, y1) = furniture.x_m, furniture.y_m
    shape = (round((y1 - y0) / _UNDERSIDE_TEXEL_M) + 2, round((x1 - x0) / _UNDERSIDE_TEXEL_M) + 2)
    opacity = np.zeros(shape, dtype=np.uint16)
    opacity[1:-1, 1:-1] = OPAQUE
    dark = np.where(opacity > 0, 18 * LEVELS_PER_GREY, 0).astype(np.uint16)
    origin = (x0 - 0.5 * _UNDERSIDE_TEXEL_M, y0 - 0.5 * _UNDERSIDE_TEXEL_M)
    return Layer(furniture.height_m, origin, _UNDERSIDE_TEXEL_M, dark, opacity)
