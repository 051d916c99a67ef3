"""Attitude from the IMU alone, for predictions of the tracker that precede those of the filter."""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np

from gyrocal_ros.data import Array, ImuSample, nanoseconds, seconds
from gyrocal_ros.model.planar import step_nearly_level

HISTORY_S = 2.0
"""Length of the buffer; older search regions are not usable."""
LEVELLING_TIME_S = 1.0
"""Time constant of the decay of roll and pitch to level: the robot drives on a floor."""
MAX_GAP_S = 0.5
"""Largest gap between IMU samples over which the rate is integrated."""


class GyroAttitude:
    """Attitude of the body in the latest seconds, integrated from its nominal rates.

    The error of the yaw is that of the gyro. Roll and pitch follow the gyro over a short time, such as
    the crossing of a threshold, and decay to level, because the gyro biases would accumulate otherwise.
    """

    def __init__(self) -> None:
        self._t_ns: list[int] = []
        self._euler: list[tuple[float, float, float]] = []
        self._rate = (0.0, 0.0, 0.0)

    @property
    def until_ns(self) -> int | None:
        """Time of the latest sample."""
        return self._t_ns[-1] if self._t_ns else None

    def add(self, sample: ImuSample) -> None:
        """Add one sample, in body axes; a sample that is not newer than the last one is ignored."""
        if not self._t_ns:
            self._t_ns, self._euler, self._rate = [sample.t_ns], [(0.0, 0.0, 0.0)], sample.rate_rad_s
            return
        if sample.t_ns <= self._t_ns[-1]:
            return
        dt_s = seconds(sample.t_ns - self._t_ns[-1])
        (ax, ay, az), (bx, by, bz) = self._rate, sample.rate_rad_s
        turned = 0.5 * dt_s if dt_s < MAX_GAP_S else 0.0
        self._t_ns.append(sample.t_ns)
        self._euler.append(
            step_nearly_level(
                self._euler[-1],
                (turned * (ax + bx), turned * (ay + by), turned * (az + bz)),
                kept=math.exp(-dt_s / LEVELLING_TIME_S),
            )
        )
        self._rate = sample.rate_rad_s
        if self._t_ns[0] < sample.t_ns - nanoseconds(2.0 * HISTORY_S):
            old = bisect_left(self._t_ns, sample.t_ns - nanoseconds(HISTORY_S))
            del self._t_ns[:old], self._euler[:old]

    def at(self, t_ns: int) -> Array | None:
        """Return roll, pitch and yaw (3,), interpolated linearly, or None outside the buffer.

        Up to `MAX_GAP_S` beyond the latest sample the attitude is extrapolated with its rate.
        """
        if not self._t_ns or not self._t_ns[0] <= t_ns < self._t_ns[-1] + nanoseconds(MAX_GAP_S):
            return None
        after = bisect_left(self._t_ns, t_ns)
        if after == len(self._t_ns):
            return np.array(self._euler[-1]) + seconds(t_ns - self._t_ns[-1]) * np.array(self._rate)
        later = np.array(self._euler[after])
        if self._t_ns[after] == t_ns:
            return later
        part = (self._t_ns[after] - t_ns) / (self._t_ns[after] - self._t_ns[after - 1])
        return later + part * (np.array(self._euler[after - 1]) - later)
