"""Detection of a lost map: images that contradict it again and again."""

from __future__ import annotations

from gyrocal_ros.data import NS_PER_S
from gyrocal_ros.ekf.adaptive_noise import AdaptiveNoise
from gyrocal_ros.ekf.update import MeasurementUpdate
from gyrocal_ros.errors import FilterDivergedError

LOST_IMAGES = 15
"""Number of consecutive images that contradict the map before it is dropped."""
MAX_RESTARTS = 5
"""Number of maps that may be dropped within `WINDOW_NS` before the filter has diverged."""
WINDOW_NS = 60 * NS_PER_S
CHECK_THE_CAMERA = 'check the camera calibration, its mounting and the time stamps with `gyrocal check`'


class MapWatch:
    """Decides when the map is lost."""

    def __init__(self) -> None:
        self._contradicted = 0
        self._losses_ns: list[int] = []

    def is_lost(self, update: MeasurementUpdate, pixel_noise: AdaptiveNoise, t_ns: int) -> bool:
        """Return True if the map has to be dropped after an image at that time.

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
        self._losses_ns = [lost_ns for lost_ns in self._losses_ns if t_ns - lost_ns < WINDOW_NS] + [t_ns]
        if len(self._losses_ns) > MAX_RESTARTS:
            count = len(self._losses_ns)
            what = f'the images contradict the estimate again and again ({count} new maps within a minute)'
            raise FilterDivergedError(what, todo=CHECK_THE_CAMERA)
        return True
