"""Detection of standing still."""

from __future__ import annotations

from gyrocal_ros.data import MotionBlock, seconds


class RestDetector:
    """Decides whether the robot stands still: the wheels have not moved for some time."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def is_at_rest(self, block: MotionBlock, settle_s: float) -> bool:
        """Return True if the robot has been at rest for `settle_s`; a gap in the IMU is not rest."""
        if not block.wheels_at_rest or block.gap_s > 0.0:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = block.start_ns
        return seconds(block.end_ns - self._since_ns) > settle_s
