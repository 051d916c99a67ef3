"""Motion of features from one image to the next, by the images alone.

The tracker predicts where features are from the gyro. Where stamps are late, or the gyro is at its limit, the
prediction is off by more than any search region; the flow of the image needs none.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array
from gyrocal_ros.vision.lens_marks import STAYED_PX

WINDOW_PX, LEVELS = 21, 4
"""Window and levels of the image pyramid: motion of some 100 pixels is followed."""
BACKWARD_PX = 0.5
"""Distance from the start up to which the flow back to the first image has to lead: in noise it does not."""
INLIER_PX = 3.0
"""Distance from the common motion up to which a feature agrees with it."""
MIN_AGREEING, AGREEING_PART = 6, 0.6
"""Number of features that have to agree, and their part of all: by chance a few agree in the noise of a dark
image, too."""


def followed(before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: Array) -> tuple[Array, Array]:
    """Follow features from one image to another without a prediction.

    Pyramidal Lucas-Kanade (Bouguet 2000), and of its results those that agree with one rotation, shift and
    scale of the image (RANSAC).

    Args:
        before: (height, width) grey values.
        after: the same.
        pixels: (n, 2) features in `before`.

    Returns:
        (n, 2) their pixels in `after`, and (n,) True for those that agree. None where too few do, or where
        they stay in the image: that is a pattern of the sensor or dust on the lens, as in a dark room.
    """
    none = pixels, np.zeros(len(pixels), bool)
    if len(pixels) < MIN_AGREEING:
        return none
    starts = pixels.astype(np.float32)[:, None]
    moved, is_found = _flow(before, after, starts)
    back, is_found_back = _flow(after, before, moved)
    returns = np.linalg.norm(back - starts, axis=2)[:, 0] < BACKWARD_PX
    kept = np.flatnonzero(is_found & is_found_back & returns)
    if len(kept) < MIN_AGREEING:
        return none
    _, is_inlier = cv2.estimateAffinePartial2D(starts[kept], moved[kept], ransacReprojThreshold=INLIER_PX)
    agreeing = none[1].copy()
    agreeing[kept] = is_inlier[:, 0] != 0 if is_inlier is not None else False
    is_common = agreeing.sum() >= max(MIN_AGREEING, AGREEING_PART * len(pixels))
    shift_px = np.linalg.norm(moved - starts, axis=2)[agreeing, 0]
    has_moved = is_common and float(np.median(shift_px)) > STAYED_PX
    return (moved[:, 0].astype(float), agreeing) if has_moved else none


def _flow(
    before: NDArray[np.uint8], after: NDArray[np.uint8], points: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    moved, is_found, _ = cv2.calcOpticalFlowPyrLK(  # type: ignore[call-overload]
        before, after, points, None, winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS
    )
    return moved, is_found[:, 0] != 0
