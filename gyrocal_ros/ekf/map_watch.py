"""Detection of a lost map: images that contradict it again and again."""

from __future__ import annotations

from gyrocal_ros.ekf.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.update import MeasurementUpdate
from gyrocal_ros.errors import FilterDivergedError

LOST_IMAGES = 15
"""Number of consecutive images that contradict the map before it is dropped."""
MAX_RESTARTS = 10
"""Number of maps that may be dropped before the filter has diverged."""
CHECK_THE_CAMERA = 'check the camera calibration, its mounting and the time stamps with `gyrocal check`'


class MapWatch:
    """Decides when the map is lost."""

    def __init__(self) -> None:
        self._contradicted = 0
        self._restarts = 0

    def is_lost(self, update: MeasurementUpdate, pixel_noise: AdaptiveNoise) -> bool:
        """Return True if the map has to be dropped after an image.

        Raises:
            FilterDivergedError: the images contradict the estimate beyond repair.
        """
        if pixel_noise.is_at_limit:
            what = f'the innovations of the images exceed {pixel_noise.std:.0f} px'
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        contradicts = update.rejected > 2 * update.used and update.rejected >= 3
        self._contradicted = self._contradicted + 1 if contradicts else 0
        if self._contradicted < LOST_IMAGES:
            return False
        self._contradicted = 0
        self._restarts += 1
        if self._restarts > MAX_RESTARTS:
            what = f'the images contradict the estimate again and again ({self._restarts} new maps)'
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        return True
