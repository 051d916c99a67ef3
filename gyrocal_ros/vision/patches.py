"""Patches of the image at first sight, and Lucas-Kanade: where each of them is now.

Inverse compositional (Baker and Matthews 2004): the slopes come from the patch of first sight, so
all but the sampling of the image is computed once. Between its pixels the image is a cubic B-spline
with the grey values as coefficients: a slight smoothing, the same for patch and image at any
fraction of a pixel, which linear interpolation is not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array

MAX_ITERATIONS = 10
MAX_STEP_PX = 2.0
CONVERGED_PX = 0.01
_TINY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """n square patches of m points; lengths in pixels of the image of first sight.

    The present image shows a patch shifted by tau and twisted by phi in another light: with a gain,
    an offset and a slope of the brightness that do not matter here,
    image = gain (template + slopes tau + turning phi) + offset + slope.
    """

    template: Array
    """(n, m) grey values, flattened."""
    contrast: Array
    """(n,) sum of squares of the template."""
    to_shift: Array
    """(n, 2, m) image / gain to tau, where there is no twist."""
    to_twist: Array
    """(n, m) image / gain to phi, whatever the shift."""
    twist_weight: Array
    """(n,) how well the patch shows a twist."""
    shift_by_twist: Array
    """(n, 2) how much less tau is for each unit of phi."""
    information: Array
    """(n,) grey^2/px^2: noise variance over this is the variance of the worse determined shift."""

    def __len__(self) -> int:
        return len(self.template)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Patches:
        return Patches(*(getattr(self, item.name)[chosen] for item in fields(self)))

    def __add__(self, more: Patches) -> Patches:
        both = ((getattr(self, item.name), getattr(more, item.name)) for item in fields(self))
        return Patches(*map(np.concatenate, both))


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """What Lucas-Kanade found."""

    pixels: Array
    """(n, 2) where the centres of the patches are."""
    twist_rad: float
    """How much further than predicted all patches are turned, from image u towards v."""
    correlation: Array
    """(n,) between patch and image, -1 to 1."""
    backward_px: Array
    """(n,) how far off the first patch is when it is looked for with the present one."""


@cache
def grid(size: int) -> Array:
    """Offsets (size * size, 2) of the points of a patch from its centre, row by row."""
    axis = np.arange(size) - size // 2
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2).astype(float)


def extract_patches(image: NDArray[np.uint8], centres: NDArray[np.int64], size: int) -> Patches:
    """Take square patches of odd size out of an image (height, width), at whole pixels (n, 2) u, v."""
    reach = np.arange(size + 2) - (size // 2 + 1)
    rows, columns = centres[:, 1, None] + reach, centres[:, 0, None] + reach
    crop = image[rows[:, :, None], columns[:, None, :]].astype(float)
    smooth, slope = _band(size, 1 / 6, 4 / 6, 1 / 6), _band(size, -1 / 2, 0.0, 1 / 2)
    template, by_u, by_v = (
        (down @ crop @ across.T).reshape(-1, size * size)
        for down, across in ((smooth, smooth), (smooth, slope), (slope, smooth))
    )
    u, v = grid(size).T
    template = _detrended(template)
    contrast = (template**2).sum(axis=1)
    slopes = _detrended(np.stack([by_u, by_v, u * by_v - v * by_u], axis=1))
    by_gain = slopes @ template[:, :, None] / (contrast + _TINY)[:, None, None]
    slopes = slopes - by_gain * template[:, None, :]
    shifts, turning = slopes[:, :2], slopes[:, 2]
    normal = shifts @ shifts.transpose(0, 2, 1)
    inverse = np.linalg.inv(normal + _TINY * np.eye(2))
    shift_by_twist = (inverse @ (shifts @ turning[:, :, None]))[:, :, 0]
    turning = turning - (shift_by_twist[:, None, :] @ shifts)[:, 0]
    twist_weight = (turning**2).sum(axis=1)
    return Patches(
        template=template,
        contrast=contrast,
        to_shift=inverse @ shifts,
        to_twist=turning / (twist_weight + _TINY)[:, None],
        twist_weight=twist_weight,
        shift_by_twist=shift_by_twist,
        information=np.linalg.eigvalsh(normal)[:, 0],
    )


def _band(size: int, before: float, here: float, after: float) -> Array:
    """Matrix (size, size + 2) that weighs three neighbours."""
    return sum(
        (tap * np.eye(size, size + 2, k) for k, tap in enumerate((before, here, after))), start=np.zeros(())
    )


def align(image: NDArray[np.uint8], patches: Patches, points: Array, min_correlation: float) -> Alignment:
    """Lucas-Kanade from a prediction, for all patches at once, in whatever light.

    The patches may be turned further than predicted, but all by the same angle: the prediction of the
    attitude errs for all of them alike, and one common angle costs next to no accuracy.

    Args:
        image: (height, width).
        patches: n of them.
        points: (n, m, 2) pixels where the points of the patches are expected.
        min_correlation: patches that look less like the image have no say about the twist.
    """
    size = round(points.shape[1] ** 0.5)
    centre = points.shape[1] // 2
    by_pixel = 0.5 * np.stack(
        [points[:, centre + 1] - points[:, centre - 1], points[:, centre + size] - points[:, centre - size]],
        axis=1,
    )
    shift, twist = np.zeros((len(points), 2)), 0.0
    for _ in range(MAX_ITERATIONS):
        c, s = np.cos(twist), np.sin(twist)
        turn = np.array([[c, s], [-s, c]])
        moved = shift[:, None, :] + grid(size) @ (turn - np.eye(2))
        present, correlation = _brightness_normalised(patches, sample_image(image, points + moved @ by_pixel))
        good = correlation > min_correlation
        vote = good * patches.twist_weight
        excess = (present * patches.to_twist).sum(axis=1)
        twist_step = float(vote @ excess / (vote.sum() + _TINY))
        step = (patches.to_shift @ present[:, :, None])[:, :, 0] - patches.shift_by_twist * twist_step
        shift = shift - np.clip(step, -MAX_STEP_PX, MAX_STEP_PX) @ turn
        twist -= twist_step
        if not good.any() or np.abs(step[good]).max() < CONVERGED_PX:
            break
    pixels = points[:, centre] + (shift[:, None, :] @ by_pixel)[:, 0]
    return Alignment(pixels, twist, correlation, _backward_shift(present, patches.template))


def sample_image(image: NDArray[np.uint8], points: Array) -> Array:
    """Smoothed grey values (...) of an image (height, width) at points (..., 2) u, v, clipped to it."""
    height, width = image.shape
    points = np.clip(points, 1.0, [width - 3, height - 3])
    whole = points.astype(np.int64)
    fraction = (points - whole).astype(np.float32)
    across, down = _spline(fraction[..., 0]), _spline(fraction[..., 1])
    corner = (whole[..., 1] - 1) * width + (whole[..., 0] - 1)
    flat = image.ravel()
    values = np.zeros(points.shape[:-1], dtype=np.float32)
    for row, down_weight in enumerate(down):
        line = across[0] * flat.take(corner + row * width)
        for column in (1, 2, 3):
            line += across[column] * flat.take(corner + (row * width + column))
        values += down_weight * line
    return values.astype(float)


def _spline(f: NDArray[np.float32]) -> tuple[NDArray[Any], ...]:
    """Weights of the four nearest coefficients of a cubic B-spline, at the fraction f after the second."""
    g = 1.0 - f
    first, last = g * g * g / 6.0, f * f * f / 6.0
    second = 2.0 / 3.0 - f * f * (1.0 - 0.5 * f)
    return first, second, 1.0 - first - second - last, last


def _detrended(values: Array) -> Array:
    """Values (..., m) on a patch less their mean and slope, which the light of the lens' edge changes."""
    plane = _plane(round(values.shape[-1] ** 0.5))
    return values - values @ plane @ plane.T


@cache
def _plane(size: int) -> Array:
    """Constant and slopes on a patch (m, 3), orthonormal."""
    columns = np.column_stack([np.ones(size * size), grid(size)])
    return columns / np.linalg.norm(columns, axis=0)


def _brightness_normalised(patches: Patches, grey: Array) -> tuple[Array, Array]:
    """Grey values (n, m) brought to the light of the patches, and their correlation (n,) with them."""
    flat = _detrended(grey)
    common = (flat * patches.template).sum(axis=1)
    limit = np.sqrt((flat**2).sum(axis=1) * patches.contrast) + _TINY
    gain = np.maximum(common, 0.05 * limit) / (patches.contrast + _TINY)
    return flat / gain[:, None], common / limit


def _backward_shift(present: Array, template: Array) -> Array:
    """Length (n,) of the first step of Lucas-Kanade from the present patch back to the first one."""
    size = round(template.shape[1] ** 0.5)
    inner = (size - 2) ** 2
    square, difference = (values.reshape(-1, size, size) for values in (present, template - present))
    by_u = 0.5 * (square[:, 1:-1, 2:] - square[:, 1:-1, :-2])
    by_v = 0.5 * (square[:, 2:, 1:-1] - square[:, :-2, 1:-1])
    slopes = np.stack([by_u, by_v], axis=1).reshape(-1, 2, inner)
    normal = slopes @ slopes.transpose(0, 2, 1) + _TINY * np.eye(2)
    step = np.linalg.solve(normal, slopes @ difference[:, 1:-1, 1:-1].reshape(-1, inner, 1))
    return np.linalg.norm(step[:, :, 0], axis=1)
