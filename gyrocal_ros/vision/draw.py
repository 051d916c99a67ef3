"""Drawing of tracks for display."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import FeatureObservations, SearchRegions
from gyrocal_ros.vision.search_region import SIGMAS

FOUND = (80, 220, 80)
MISSED = (60, 60, 230)
_FRACTION_BITS = 4


def draw_tracks(
    image: NDArray[np.uint8], observations: FeatureObservations, regions: SearchRegions | None
) -> NDArray[np.uint8]:
    """Draw features as crosses with their ids, and their search regions as ellipses.

    Args:
        image: (height, width) grey values.
        observations: features found in the image.
        regions: search regions from the filter; green if the feature was found, red if not.

    Returns:
        (height, width, 3), blue, green, red.
    """
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if regions is not None:
        for id_, centre, covariance in zip(regions.ids, regions.pixels, regions.covariances_px2, strict=True):
            variances, axes = np.linalg.eigh(covariance)
            half_axes = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
            angle = np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))
            colour = FOUND if id_ in observations.ids else MISSED
            cv2.ellipse(
                picture,
                _fixed(centre),
                _fixed(half_axes),
                angle,
                0.0,
                360.0,
                colour,
                1,
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
    for id_, pixel in zip(observations.ids, observations.pixels, strict=True):
        u, v = np.rint(pixel).astype(int).tolist()
        cv2.drawMarker(picture, (u, v), FOUND, cv2.MARKER_CROSS, 9)
        cv2.putText(picture, str(id_), (u + 6, v - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, FOUND, 1, cv2.LINE_AA)
    return picture.astype(np.uint8, copy=False)


def _fixed(point: NDArray[np.float64]) -> tuple[int, int]:
    """Return a point in OpenCV's fixed-point coordinates, clipped to a safe range."""
    u, v = np.rint(np.clip(point, -1e5, 1e5) * 2**_FRACTION_BITS).astype(int).tolist()
    return u, v
