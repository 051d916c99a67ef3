"""Rendering of ceiling images: lens, parallax, vignetting, exposure, blur, noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, CameraIntrinsics
from gyrocal_ros.model.camera import bearing
from gyrocal_ros.sim.texture import LEVELS_PER_GREY, OPAQUE, Layer, ceiling_layers

TEXELS_PER_PIXEL = 3.0
"""Texture resolution. OpenCV rounds positions to 1/32 texel; this many texels reduce it to 0.01 pixel,
which does not accumulate."""
_COARSE = 8
"""Step, in pixels, of the search for the part of the image that a plane covers."""


class CeilingRenderer:
    """Renders the images of a camera below a ceiling.

    Args:
        camera: its intrinsics.
        layers: visible planes, from high to low.
        read_noise: standard deviation of a pixel, in grey levels.
        vignetting: relative loss of brightness in the corners of the image.
    """

    def __init__(
        self,
        camera: CameraIntrinsics,
        layers: Sequence[Layer],
        *,
        read_noise: float = 1.2,
        vignetting: float = 0.25,
    ) -> None:
        self._camera = camera
        self._layers = layers
        self._read_noise = np.float32(read_noise)
        v, u = np.mgrid[: camera.height_px, : camera.width_px].astype(float)
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        self._rays = bearing(camera, pixels).astype(np.float32).reshape(*u.shape, 2)
        middle = 0.5 * np.array([camera.width_px - 1, camera.height_px - 1])
        radius = np.linalg.norm(pixels - middle, axis=1).reshape(u.shape) / np.linalg.norm(middle)
        self._gain = ((1.0 - vignetting * radius**2) / LEVELS_PER_GREY).astype(np.float32)

    def render(
        self,
        R_wc: Array,
        p_wc: Array,
        *,
        exposure: float = 1.0,
        blur: Sequence[tuple[Array, Array]] = (),
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """Render one image.

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
        poses = blur or [(R_wc, p_wc)]
        image = self._sharp(*poses[0])
        for pose in poses[1:]:
            image += self._sharp(*pose)
        image *= self._gain * np.float32(exposure / len(poses))
        if rng is not None:
            image += self._read_noise * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(image, out=image), 0.0, 255.0, out=image).astype(np.uint8)

    def _sharp(self, R_wc: Array, p_wc: Array) -> NDArray[np.float32]:
        """Return the brightness (height, width) from one pose, without vignetting."""
        image = np.zeros(self._rays.shape[:2], dtype=np.float32)
        for layer in self._layers:
            to_texels = _rays_to_texels(layer, R_wc, p_wc)
            if layer.opacity is None:
                positions = cv2.perspectiveTransform(self._rays, to_texels)
                image = _interpolated(layer.brightness, positions, cv2.BORDER_WRAP)
                continue
            part = self._covered_part(layer, to_texels)
            if part is not None:
                positions = cv2.perspectiveTransform(np.ascontiguousarray(self._rays[part]), to_texels)
                image[part] *= 1.0 - _interpolated(layer.opacity, positions) / np.float32(OPAQUE)
                image[part] += _interpolated(layer.brightness, positions)
        return image

    def _covered_part(self, layer: Layer, to_texels: Array) -> tuple[slice, slice] | None:
        """Return rows and columns of the image that a plane may cover, or None if it is not in view."""
        texels = cv2.perspectiveTransform(np.ascontiguousarray(self._rays[::_COARSE, ::_COARSE]), to_texels)
        reach = 2.0 * _COARSE * TEXELS_PER_PIXEL
        limits = np.array(layer.brightness.shape[::-1]) + reach
        near = ((texels > -reach) & (texels < limits)).all(axis=-1)
        if not near.any():
            return None
        rows, columns = (np.flatnonzero(np.any(near, axis=axis)) for axis in (1, 0))
        return (
            slice(max(0, _COARSE * (rows[0] - 1)), _COARSE * (rows[-1] + 1)),
            slice(max(0, _COARSE * (columns[0] - 1)), _COARSE * (columns[-1] + 1)),
        )


def _interpolated(
    texels: NDArray[np.uint16], positions: cv2.typing.MatLike, border: int = cv2.BORDER_CONSTANT
) -> NDArray[np.float32]:
    """Return interpolated texels at positions (rows, columns, 2); by default zero beyond the edge."""
    values = cv2.remap(texels, positions, None, cv2.INTER_LINEAR, borderMode=border)  # type: ignore[call-overload]
    return np.asarray(values, np.float32)


def _rays_to_texels(layer: Layer, R_wc: Array, p_wc: Array) -> Array:
    """Return the homography (3, 3) from normalised image coordinates to columns and rows of a layer."""
    distance = layer.height_m - p_wc[2]
    to_plane = np.array(
        [
            [distance, 0.0, p_wc[0] - layer.origin_m[0]],
            [0.0, distance, p_wc[1] - layer.origin_m[1]],
            [0.0, 0.0, layer.texel_m],
        ]
    )
    return to_plane @ R_wc / layer.texel_m


def ceiling_renderer(
    camera: CameraIntrinsics,
    seed: int,
    *,
    ceiling_height_m: float = 2.5,
    objects: int = 8,
    read_noise: float = 1.2,
) -> CeilingRenderer:
    """Return a renderer for a camera near the floor below a random ceiling."""
    texel_m = ceiling_height_m / (TEXELS_PER_PIXEL * math.sqrt(camera.fx_px * camera.fy_px))
    layers = ceiling_layers(np.random.default_rng(seed), ceiling_height_m, texel_m, objects=objects)
    return CeilingRenderer(camera, layers, read_noise=read_noise)
