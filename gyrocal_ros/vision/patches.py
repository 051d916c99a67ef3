"""Patches from the image of first detection, and their Lucas-Kanade alignment in later images.

Inverse compositional (Baker and Matthews 2004): the gradients are those of the first patch, so that
everything but the sampling of the image is computed once. Between its pixels the image is a cubic
B-spline with the grey values as coefficients. This is a slight smoothing, equal for patch and image at
any fraction of a pixel, which linear interpolation is not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array

MAX_ITERATIONS = 10
MAX_STEP_PX = 2.0
CONVERGED_PX = 0.01
MATCHING_PX = 0.06
"""Standard deviation of the errors of a match that its residual does not show."""
SMOOTHING = 4.0
"""Variance of white noise over that of its residual, which the spline smooths (`sample_image`)."""
MIN_CORRELATION = 0.05
"""Correlation below which the residual says no more."""
FITTED = 6
"""Numbers fitted to a patch: gain, offset, gradient, shift."""
NODE_CENTRE = 4
"""Index of the node at the centre of a patch."""
_TINY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """n square patches of m points; lengths in pixels of the image of first detection.

    The current image shows a patch shifted by tau, rotated by phi and with another brightness; the
    gain, the offset and the gradient of the brightness are eliminated:

        image = gain (template + slopes tau + turning phi) + offset + slope
    """

    template: Array
    """(n, m) grey values without mean and gradient."""
    contrast: Array
    """(n,) sum of squares of the template."""
    to_shift: Array
    """(n, 2, m) matrix from image / gain to tau, without a rotation."""
    to_twist: Array
    """(n, m) matrix from image / gain to phi, independent of the shift."""
    twist_weight: Array
    """(n,) information of the patch about a rotation."""
    shift_by_twist: Array
    """(n, 2) decrease of tau per unit of phi."""
    information: Array
    """(n,) grey^2/px^2: the noise variance divided by it is the variance of the worse determined shift."""

    def __len__(self) -> int:
        return len(self.template)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Patches:
        return Patches(*(getattr(self, item.name)[chosen] for item in fields(self)))

    def __add__(self, more: Patches) -> Patches:
        both = ((getattr(self, item.name), getattr(more, item.name)) for item in fields(self))
        return Patches(*map(np.concatenate, both))


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Result of the Lucas-Kanade alignment."""

    pixels: Array
    """(n, 2) positions of the centres of the patches."""
    twist_rad: float
    """Rotation of all patches beyond the predicted one, from image u towards v."""
    twist_std_rad: float
    """Its standard deviation, by structure and residual of the patches; infinite where none is good."""
    correlation: Array
    """(n,) correlation of patch and image, -1 to 1."""
    backward_px: Array
    """(n,) distance by which the backward alignment of the first patch with the current one misses."""
    covariances_px2: Array
    """(n, 2, 2) covariances of the positions, by structure and residual of each patch."""


@cache
def grid(size: int) -> Array:
    """Return the offsets (size * size, 2) of the points of a patch from its centre, row by row."""
    axis = np.arange(size) - size // 2
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2).astype(float)


def extract_patches(image: NDArray[np.uint8], centres: NDArray[np.int64], size: int) -> Patches:
    """Extract square patches of odd size from an image (height, width), at whole pixels (n, 2) u, v."""
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
    inverse = _inverses(normal + _TINY * np.eye(2))
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
    """Return the matrix (size, size + 2) that weights three neighbours."""
    return sum(
        (tap * np.eye(size, size + 2, k) for k, tap in enumerate((before, here, after))), start=np.zeros(())
    )


def align(image: NDArray[np.uint8], patches: Patches, nodes: Array, min_correlation: float) -> Alignment:
    """Align all patches by Lucas-Kanade from predicted points, independent of the brightness.

    The patches may be rotated beyond the predicted rotation by one common angle: the error of the
    predicted attitude is the same for all of them, and one common angle costs almost no accuracy.

    Args:
        image: (height, width).
        patches: n patches.
        nodes: (n, 9, 2) pixels of the predicted `node_offsets` of the patches.
        min_correlation: patches with a smaller correlation do not contribute to the rotation.
    """
    size = round(patches.template.shape[1] ** 0.5)
    points = patch_points(nodes, size).transpose(1, 0, 2)
    by_pixel = node_basis(nodes, size)
    to_pixels = by_pixel.transpose(0, 2, 1)
    shift, twist = np.zeros((len(nodes), 2)), 0.0
    for _ in range(MAX_ITERATIONS):
        c, s = np.cos(twist), np.sin(twist)
        turn = np.array([[c, s], [-s, c]])
        moved = shift[:, :, None] + (turn - np.eye(2)).T @ grid(size).T
        at = points + to_pixels @ moved
        current, correlation = _brightness_normalised(patches, sample_image(image, at[:, 0], at[:, 1]))
        good = correlation > min_correlation
        weight = good * patches.twist_weight
        excess = (current * patches.to_twist).sum(axis=1)
        twist_step = float(weight @ excess / (weight.sum() + _TINY))
        step = (patches.to_shift @ current[:, :, None])[:, :, 0] - patches.shift_by_twist * twist_step
        shift = shift - np.clip(step, -MAX_STEP_PX, MAX_STEP_PX) @ turn
        twist -= twist_step
        if not good.any() or np.abs(step[good]).max() < CONVERGED_PX:
            break
    pixels = nodes[:, NODE_CENTRE] + (shift[:, None, :] @ by_pixel)[:, 0]
    backward_px = _backward_shift(current, patches.template)
    variance = _noise_variance(patches, correlation)
    covariances = _covariances(patches, variance, by_pixel)
    return Alignment(pixels, twist, _twist_std(variance, weight), correlation, backward_px, covariances)


def _noise_variance(patches: Patches, correlation: Array) -> Array:
    """Return the variance (n,) of the white noise of aligned patches, grey^2, by their correlations (n,)."""
    dof = patches.template.shape[1] - FITTED
    residual = patches.contrast * (1.0 / np.maximum(correlation, MIN_CORRELATION) ** 2 - 1.0) / dof
    variance: Array = SMOOTHING * residual
    return variance


def _twist_std(variance: Array, weight: Array) -> float:
    """Return the standard deviation of the mean of the rotations of patches with these weights (n,)."""
    total = float(weight.sum())
    return float(np.sqrt(weight @ variance)) / total if total > 0.0 else np.inf


def _covariances(patches: Patches, variance: Array, by_pixel: Array) -> Array:
    """Return the covariances (n, 2, 2) of the positions of aligned patches.

    White noise of the image gives the covariance of a least-squares shift. Errors of the warp, of the lens
    and of the interpolation are not white; `MATCHING_PX` stands for them.

    Args:
        patches: n patches.
        variance: (n,) of their noise.
        by_pixel: (n, 2, 2) derivative of the pixels by u, v of the patch.
    """
    in_patch = patches.to_shift @ patches.to_shift.transpose(0, 2, 1)
    own = by_pixel.transpose(0, 2, 1) @ (variance[:, None, None] * in_patch) @ by_pixel
    covariances: Array = own + MATCHING_PX**2 * np.eye(2)
    return covariances


def node_offsets(size: int) -> Array:
    """Return the offsets (9, 2) of the nodes of a patch: its corners, the middles of its edges, its centre.

    A predicted patch is given by the pixels of these nodes and is biquadratic between them.
    """
    return (size // 2) * grid(3)


def node_basis(nodes: Array, size: int) -> Array:
    """Return the derivative (n, 2, 2) of the pixels u, v (last axis) by u, v of the patch, at its centre.

    Args:
        nodes: (n, 9, 2) pixels of the nodes.
        size: side of the patch.
    """
    return (nodes[:, [5, 7]] - nodes[:, [3, 1]]) / (2 * (size // 2))


def patch_points(nodes: Array, size: int) -> Array:
    """Return the pixels (2, n, size * size) of all points of patches from those of the nodes (n, 9, 2)."""
    return nodes.transpose(2, 0, 1) @ _between_nodes(size)


@cache
def _between_nodes(size: int) -> Array:
    """Return the weights (9, size * size) of the nodes at each point: products of Lagrange polynomials."""
    t = grid(size)[:size, 0] / (size // 2)
    weights = np.array([0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)])
    return np.einsum('iv,ju->ijvu', weights, weights).reshape(9, -1)


def sample_image(image: NDArray[np.uint8], u: Array, v: Array) -> Array:
    """Return smoothed grey values (...) of an image (height, width) at pixels u (...), v (...).

    The points are clipped to the image.
    """
    height, width = image.shape
    u, v = np.clip(u, 1.0, width - 3), np.clip(v, 1.0, height - 3)
    left, top = u.astype(np.intp), v.astype(np.intp)
    coefficients = image.ravel().take(_neighbours(width, u.ndim) + (top * width + left))
    return np.einsum('ij...,i...,j...->...', coefficients, _spline(v - top), _spline(u - left)).astype(float)


@cache
def _neighbours(width: int, dimensions: int) -> NDArray[np.intp]:
    """Return the index offsets (4, 4, 1, ...) of the coefficients that a point depends on."""
    reach = np.arange(-1, 3)
    return (reach[:, None] * width + reach).reshape(4, 4, *(1,) * dimensions)


def _spline(fraction: Array) -> NDArray[np.float32]:
    """Return the weights (4, ...) of the four nearest coefficients of a cubic B-spline.

    Args:
        fraction: distance after the second of the four.
    """
    f = fraction.astype(np.float32)
    g = 1.0 - f
    weights = np.empty((4, *f.shape), np.float32)
    weights[0] = g * g * g / 6.0
    weights[1] = 2.0 / 3.0 - f * f * (1.0 - 0.5 * f)
    weights[3] = f * f * f / 6.0
    weights[2] = 1.0 - weights[0] - weights[1] - weights[3]
    return weights


def _detrended(values: Array) -> Array:
    """Return values (..., m) on a patch without their mean and gradient, which vignetting changes."""
    plane = _plane(round(values.shape[-1] ** 0.5))
    return values - values @ plane @ plane.T


@cache
def _plane(size: int) -> Array:
    """Return an orthonormal basis of constant and gradient on a patch (m, 3)."""
    columns = np.column_stack([np.ones(size * size), grid(size)])
    return columns / np.linalg.norm(columns, axis=0)


def _brightness_normalised(patches: Patches, grey: Array) -> tuple[Array, Array]:
    """Return grey values (n, m) scaled to the brightness of the patches, and their correlation (n,)."""
    flat = _detrended(grey)
    common = (flat * patches.template).sum(axis=1)
    limit = np.sqrt((flat**2).sum(axis=1) * patches.contrast) + _TINY
    gain = np.maximum(common, 0.05 * limit) / (patches.contrast + _TINY)
    return flat / gain[:, None], common / limit


def _backward_shift(current: Array, template: Array) -> Array:
    """Return the length (n,) of the first Lucas-Kanade step from the current patch back to the first one."""
    size = round(template.shape[1] ** 0.5)
    inner = (size - 2) ** 2
    square, difference = (values.reshape(-1, size, size) for values in (current, template - current))
    by_u = 0.5 * (square[:, 1:-1, 2:] - square[:, 1:-1, :-2])
    by_v = 0.5 * (square[:, 2:, 1:-1] - square[:, :-2, 1:-1])
    slopes = np.stack([by_u, by_v], axis=1).reshape(-1, 2, inner)
    inverse = _inverses(slopes @ slopes.transpose(0, 2, 1) + _TINY * np.eye(2))
    step = inverse @ (slopes @ difference[:, 1:-1, 1:-1].reshape(-1, inner, 1))
    return np.hypot(step[:, 0, 0], step[:, 1, 0])


def _inverses(matrices: Array) -> Array:
    """Return the inverses of n symmetric matrices (n, 2, 2), by Cramer's rule."""
    a, b, c = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    adjoint = np.stack([c, -b, -b, a], axis=-1).reshape(-1, 2, 2)
    inverses: Array = adjoint / (a * c - b * b)[:, None, None]
    return inverses
