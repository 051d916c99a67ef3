"""The images of a simulated recording: what the ceiling camera films on the way."""

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
_BOARD_TEXEL_M = 0.01

CameraPoses = Callable[[Array], tuple[Array, Array]]
"""From times (n,) to R_wc (n, 3, 3) and p_wc (n, 3)."""


def film(
    camera: CameraIntrinsics,
    furniture: tuple[Furniture, ...],
    seed: int,
    time_s: Array,
    camera_poses: CameraPoses,
) -> Iterator[NDArray[np.uint8]]:
    """Take an image at each of the times (n,), which are the middles of the exposures.

    Motion blurs the images, the light changes, and furniture is dark.
    """
    texel_m = CEILING_HEIGHT_M / (TEXELS_PER_PIXEL * np.sqrt(camera.fx_px * camera.fy_px))
    ceiling = ceiling_layers(stream(seed, 'ceiling'), CEILING_HEIGHT_M, texel_m)
    boards = sorted((_board(item) for item in furniture), key=lambda layer: -layer.height_m)
    renderer = CeilingRenderer(camera, (*ceiling, *boards))
    noise = stream(seed, 'image noise')
    exposures = brightness(time_s, stream(seed, 'light'))
    shutter_s = EXPOSURE_S * ((np.arange(BLUR_POSES) + 0.5) / BLUR_POSES - 0.5)
    for now_s, exposure in zip(time_s, exposures, strict=True):
        R_wc, p_wc = camera_poses(now_s + shutter_s)
        middle = BLUR_POSES // 2
        moving = bool(np.any(R_wc != R_wc[0]) or np.any(p_wc != p_wc[0]))
        blur = list(zip(R_wc, p_wc, strict=True)) if moving else []
        yield renderer.render(R_wc[middle], p_wc[middle], exposure=float(exposure), blur=blur, rng=noise)


def brightness(time_s: Array, rng: np.random.Generator) -> Array:
    """Draw the brightness (n,) at times (n,): clouds, and a control of the exposure that lags."""
    periods_s = rng.uniform([60.0, 15.0, 5.0], [120.0, 30.0, 10.0])
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = np.sin(2.0 * np.pi * np.divide.outer(time_s, periods_s) + phases)
    return np.exp(np.einsum('nk,k->n', waves, np.array([0.10, 0.08, 0.04])))


def _board(furniture: Furniture) -> Layer:
    """The dark underside of a piece of furniture, one texel of fading round it."""
    (x0, x1), (y0, y1) = furniture.x_m, furniture.y_m
    shape = (round((y1 - y0) / _BOARD_TEXEL_M) + 2, round((x1 - x0) / _BOARD_TEXEL_M) + 2)
    opacity = np.zeros(shape, dtype=np.uint16)
    opacity[1:-1, 1:-1] = OPAQUE
    dark = np.where(opacity > 0, 18 * LEVELS_PER_GREY, 0).astype(np.uint16)
    origin = (x0 - 0.5 * _BOARD_TEXEL_M, y0 - 0.5 * _BOARD_TEXEL_M)
    return Layer(furniture.height_m, origin, _BOARD_TEXEL_M, dark, opacity)
