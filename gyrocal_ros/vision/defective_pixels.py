"""Pixels of the camera that always read too much or too little, and their replacement.

A hot pixel is a sharp corner that stays in the image: features near it are pulled along with it. Where the
camera corrects none, they are found by what they have in common: they stick out of their surroundings in
image after image, while the robot turns and everything else moves on.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.vision.corners import noise_level

SURROUNDINGS_PX = 5
"""Side of the square with which a pixel is compared, and from which it is replaced: compression spreads a
defect over its neighbours."""
MIN_EXCESS_GREY, MIN_EXCESS_SIGMA = 6.0, 1.5
"""Difference from the median of the surroundings from which a pixel sticks out, in grey levels, and relative
to the noise of the image."""
TURN_RAD = math.radians(5.0)
"""Turn after which an image counts: along a straight lane, a straight line stays where it is."""
MIN_IMAGES, MAX_IMAGES = 12, 48
"""Images from which a pixel is judged, and number from which older ones count half."""
MIN_SHARE = 0.9
"""Share of them in which a defective pixel sticks out."""
MAX_DEFECTIVE_SHARE = 0.01
"""Share of the pixels beyond which it is something else, such as a part of the robot."""


class DefectivePixels:
    """Finds the defective pixels of a camera in its images, and replaces them."""

    def __init__(self, height_px: int, width_px: int) -> None:
        self._images = 0
        self._high: NDArray[np.uint8] = np.zeros((height_px, width_px), np.uint8)
        self._low: NDArray[np.uint8] = np.zeros((height_px, width_px), np.uint8)
        self._yaw_rad = math.nan
        self._rows_columns: tuple[IntArray, IntArray] = (np.zeros(0, np.intp), np.zeros(0, np.intp))
        self._weights: Array = np.zeros((0, SURROUNDINGS_PX**2))

    @property
    def count(self) -> int:
        """Number of pixels that are replaced."""
        return len(self._weights)

    def corrected(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return an image (height, width) with its defective pixels replaced by those around them."""
        if not self.count:
            return image
        around = image[_around(*self._rows_columns, *image.shape)]
        corrected = image.copy()
        corrected[self._rows_columns] = np.rint((around * self._weights).sum(axis=1))
        return corrected

    def learn(self, image: NDArray[np.uint8], yaw_rad: float) -> None:
        """Learn from an image as it was taken, if the camera has turned since the last one that counted.

        Args:
            image: (height, width).
            yaw_rad: predicted yaw of the camera.
        """
        if abs(math.remainder(yaw_rad - self._yaw_rad, 2.0 * math.pi)) < TURN_RAD:
            return
        self._yaw_rad = yaw_rad
        excess = image - cv2.medianBlur(image, SURROUNDINGS_PX).astype(np.int16)
        least = max(MIN_EXCESS_GREY, MIN_EXCESS_SIGMA * noise_level(image))
        self._high += excess > least
        self._low += excess < -least
        self._images += 1
        if self._images >= MIN_IMAGES:
            self._judge()
        if self._images >= MAX_IMAGES:
            self._images //= 2
            self._high //= 2
            self._low //= 2

    def _judge(self) -> None:
        """Find the pixels that stick out in nearly all images."""
        is_defective = np.maximum(self._high, self._low) >= MIN_SHARE * self._images
        if np.count_nonzero(is_defective) > MAX_DEFECTIVE_SHARE * is_defective.size:
            is_defective[:] = False
        rows, columns = is_defective.nonzero()
        across = np.arange(SURROUNDINGS_PX) - SURROUNDINGS_PX // 2
        nearness = np.exp(-0.5 * (across[:, None] ** 2 + across**2)).ravel()
        weights = nearness * ~is_defective[_around(rows, columns, *is_defective.shape)]
        sums = weights.sum(axis=1)
        # In the middle of a larger mark nothing is left to replace a pixel by.
        replaced = sums > 0.0
        self._rows_columns = rows[replaced], columns[replaced]
        self._weights = weights[replaced] / sums[replaced, None]


def _around(rows: IntArray, columns: IntArray, height: int, width: int) -> tuple[IntArray, IntArray]:
    """Return rows and columns (n, 25) of the pixels around some (n,), repeated at the edge of the image."""
    down, right = (each.ravel() - SURROUNDINGS_PX // 2 for each in np.indices((SURROUNDINGS_PX,) * 2))
    return np.clip(rows[:, None] + down, 0, height - 1), np.clip(columns[:, None] + right, 0, width - 1)
