"""Features that are not on the ceiling, but on the lens or on the robot: dust, a scratch, a mast in view.

They have corners like a ceiling, but stay where they are while the view changes. To the filter they are
points at an infinite distance that turn with the robot, so a few of them say that the robot does not turn.
Where most features are of this kind, they mislead the filter, and with it every prediction. So only the image
itself can tell: the view changes if most of it no longer resembles an earlier image at the same places.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, IntArray, nanoseconds
from gyrocal_ros.vision.corners import noise_level
from gyrocal_ros.vision.dirty_lens import LIFETIME_S
from gyrocal_ros.vision.patches import Patches, extract_patches

REDUCTION = 4
"""Pixels of the image for one of the reduced image."""
BLUR, BLOCK = 9, 20
"""Sides of the blur that removes the brightness, and of a block, in pixels of the reduced image."""
MIN_VARIANCE, MIN_SIGNAL = 1.0, 8.0
"""Smallest variance of a block with texture: in grey levels, and relative to that of the noise."""
NOISE_ROWS = 4
"""Step of the rows from which the noise is estimated."""
MIN_TEXTURED = 4
"""Fewest blocks with texture that tell of a change."""
CHANGED = 0.7
"""Median correlation of the blocks below which the view has changed. At rest it is above 0.85; specks of dust
in half of all blocks leave it below."""
MIN_CHANGES = 3
"""Changes of the view, each a turn of some 5 deg, after which a feature that has stayed is not on the
ceiling: only points within a few pixels of the centre of a turn stay so long."""
STAYED_PX = 1.5
"""Distance from its first place within which a feature has stayed."""
MOVED_PX = 5.0
"""Distance from its first place at which a feature is elsewhere: a point of the ceiling, which comes back
when the robot has spun by a full turn."""


class ViewChange:
    """Counts how often the view has changed."""

    def __init__(self) -> None:
        self.number = 0
        """Number of the present view."""
        self._reference: NDArray[np.float32] | None = None
        self._energy: Array = np.empty(0)
        self._min_energy = BLOCK**2 * MIN_VARIANCE

    def add(self, image: NDArray[np.uint8]) -> None:
        """Compare an image (height, width) with the first one of the present view."""
        contrast = _local_contrast(image)
        energy = _block_sums(contrast * contrast)
        textured = energy > self._min_energy
        if textured.sum() < MIN_TEXTURED or self._resembles(contrast, energy, textured):
            return
        self.number += 1
        self._reference, self._energy = contrast, energy
        noise_variance = (noise_level(image[::NOISE_ROWS]) / REDUCTION) ** 2
        self._min_energy = BLOCK**2 * max(MIN_VARIANCE, MIN_SIGNAL * noise_variance)

    def _resembles(self, contrast: NDArray[np.float32], energy: Array, textured: NDArray[np.bool_]) -> bool:
        """Return True if the textured blocks of an image resemble those of the present view."""
        if self._reference is None:
            return False
        both = textured & (self._energy > self._min_energy)
        common = _block_sums(contrast * self._reference)[both]
        correlation = common / np.sqrt(energy[both] * self._energy[both])
        return len(common) >= MIN_TEXTURED and bool(np.median(correlation) > CHANGED)


class LensMarks:
    """Places where something on the lens was found lately."""

    def __init__(self) -> None:
        self.pixels: IntArray = np.zeros((0, 2), np.intp)
        """(n, 2) places."""
        self._found_ns: IntArray = np.zeros(0, np.int64)

    def add(self, pixels: IntArray, t_ns: int) -> None:
        """Add marks at pixels (k, 2), and forget the old ones."""
        young = np.abs(t_ns - self._found_ns) <= nanoseconds(LIFETIME_S)
        self.pixels = np.concatenate([self.pixels[young], pixels])
        self._found_ns = np.concatenate([self._found_ns[young], np.full(len(pixels), t_ns)])


def correlation_at(image: NDArray[np.uint8], patches: Patches, pixels: IntArray) -> Array:
    """Return the correlation (n,) of patches, not rotated, with an image (height, width) at pixels (n, 2)."""
    now = extract_patches(image, pixels, round(patches.template.shape[1] ** 0.5))
    common = (now.template * patches.template).sum(axis=1)
    correlation: Array = common / np.sqrt(np.maximum(now.contrast * patches.contrast, 1e-9))
    return correlation


def _local_contrast(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the reduced image without its brightness."""
    size = image.shape[1] // REDUCTION, image.shape[0] // REDUCTION
    reduced = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(reduced - cv2.blur(reduced, (BLUR, BLUR)), np.float32)


def _block_sums(values: NDArray[np.float32]) -> Array:
    """Return the sums (n,) over the whole blocks of a reduced image."""
    rows, columns = (side // BLOCK for side in values.shape)
    blocks = values[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK)
    return blocks.sum(axis=3).sum(axis=1).ravel()
