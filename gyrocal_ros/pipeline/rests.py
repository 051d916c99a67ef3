"""Rests of a recording and the noise of the yaw gyro in them, before the filter relies on either.

A filter that learns the noise as it goes uses the beginning of the first rest, from which it knows most of
the bias, before it knows how far the robot sways.
"""

from __future__ import annotations

import math

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ClockStep, ImuSample, Measurement, MotionBlock, WheelSample, nanoseconds
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.noise.rest import WINDOW_S, RestDetector, RestNoise

BLOCK_NS = nanoseconds(WINDOW_S / 5.0)
"""Shortest block; a rest ends within one."""


class RestFinder:
    """Finds the rests in the IMU and wheel samples of a recording, block by block; a pause is one block.

    Args:
        config: settings.
    """

    def __init__(self, config: Config) -> None:
        self._settle_s = config.rest.settle_s
        self._noise = RestNoise(math.radians(config.gyro.rate_noise_deg_s))
        self._buffer, self._rest, self._start_ns = MotionBuffer(), RestDetector(), -1

    @property
    def noise_rad_s(self) -> float:
        """Density of the noise at rest, rad/s/sqrt(Hz), sway included; that of the gyro without a rest."""
        return self._noise.density_rad_s

    def add(self, sample: Measurement) -> tuple[int, int] | None:
        """Take a sample; return begin and end (ns) of a block at rest that it completes."""
        if isinstance(sample, ClockStep):
            self._buffer, self._start_ns = MotionBuffer(), -1
        elif isinstance(sample, ImuSample | WheelSample):
            self._buffer.add(sample)
            block = self._completed()
            if block is not None:
                is_at_rest = self._rest.is_at_rest(block, self._settle_s)
                self._noise.add(block, is_at_rest=is_at_rest)
                return (block.start_ns, block.end_ns) if is_at_rest else None
        return None

    def _completed(self) -> MotionBlock | None:
        covered_ns, first_ns = self._buffer.covered_until_ns(), self._buffer.start_ns
        if covered_ns is None or first_ns is None:
            return None
        start_ns = max(self._start_ns, first_ns)
        if covered_ns - start_ns < BLOCK_NS:
            return None
        self._start_ns = covered_ns
        return self._buffer.cut(start_ns, covered_ns)
