"""Detection of a lost map: images that contradict it again and again."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.update import MeasurementUpdate
from gyrocal_ros.errors import FilterDivergedError

LOST_IMAGES = 15
"""Number of consecutive images that contradict the map before it is dropped."""
REMEMBERED_IMAGES = 300
"""Images over which the share of those that contradict the map is averaged."""
DOUBTFUL_SHARE = 0.08
"""Share in a whole recording from which the model does not fit: moving patches of sun reach 0.07, a rolling
shutter that the model lacks 0.10."""
MIN_REJECTED = 3
MAX_SHARE = 0.25
"""Share of contradicting images from which the filter has diverged: below crossing beams or moving patches of
sun it is 0.2 at most."""
CHECK_THE_CAMERA = 'check the camera calibration, its mounting and the time stamps with `gyrocal check`'


def contradict(used: Array, rejected: Array) -> np.ndarray:
    """Return which images contradict the map, (n,) bool, by their numbers of features used and rejected."""
    return (rejected > 2 * used) & (rejected >= MIN_REJECTED)


def is_doubtful(used: Array, rejected: Array) -> bool:
    """Return True if more images of a recording contradict the map than moving things explain.

    Args:
        used: (n,) numbers of features used.
        rejected: (n,) numbers of features rejected.
    """
    seen = used + rejected > 0
    return bool(seen.any()) and float(contradict(used, rejected)[seen].mean()) > DOUBTFUL_SHARE


class MapWatch:
    """Decides when the map is lost."""

    def __init__(self) -> None:
        self._contradicted = 0
        self._share = 0.0

    def is_lost(self, update: MeasurementUpdate, pixel_noise: AdaptiveNoise) -> bool:
        """Return True if the map has to be dropped after an image.

        Raises:
            FilterDivergedError: the images contradict the estimate beyond repair.
        """
        if pixel_noise.is_at_limit:
            what = f'the innovations of the images exceed {pixel_noise.std:.0f} px'
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        contradicts = bool(contradict(np.array(update.used), np.array(update.rejected)))
        self._share += (contradicts - self._share) / REMEMBERED_IMAGES
        if self._share > MAX_SHARE:
            what = (
                f'the images contradict the estimate again and again (every {1.0 / MAX_SHARE:.0f}th of them)'
            )
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        self._contradicted = self._contradicted + 1 if contradicts else 0
        if self._contradicted < LOST_IMAGES:
            return False
        self._contradicted = 0
        return True
