"""Noise of the yaw gyro at rest, from all rests of a recording, before the filter relies on it.

A filter that learns the noise as it goes uses the beginning of the first rest, from which it knows most of
the bias, before it knows how far the robot sways.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import ClockStep, ImuSample, Measurement, MotionBlock, WheelSample, nanoseconds
from gyrocal_ros.ekf.motion import MotionBuffer
from gyrocal_ros.ekf.rest import WINDOW_S, RestDetector, RestNoise

BLOCK_NS = nanoseconds(WINDOW_S / 5.0)
"""Shortest block; a rest ends within one."""


def with_rest_noise(config: Config, measurements: Iterable[Measurement]) -> Config:
    """Return the settings with the noise of the yaw gyro at rest; that of the gyro where there is no rest.

    Args:
        config: settings.
        measurements: the recording; only its IMU and wheel samples are used.
    """
    noise, rest = RestNoise(math.radians(config.gyro.rate_noise_deg_s)), RestDetector()
    for block in _blocks(measurements):
        noise.add(block, is_at_rest=rest.is_at_rest(block, config.rest.settle_s))
    known = replace(config.rest, rate_noise_deg_s=math.degrees(noise.density_rad_s))
    return replace(config, rest=known)


def _blocks(measurements: Iterable[Measurement]) -> Iterator[MotionBlock]:
    """Yield the blocks of a recording; a pause is one block."""
    buffer, start_ns = MotionBuffer(), -1
    for sample in measurements:
        if isinstance(sample, ClockStep):
            buffer, start_ns = MotionBuffer(), -1
        elif isinstance(sample, ImuSample | WheelSample):
            buffer.add(sample)
            covered_ns, first_ns = buffer.covered_until_ns(), buffer.start_ns
            if covered_ns is None or first_ns is None:
                continue
            start_ns = max(start_ns, first_ns)
            if covered_ns - start_ns >= BLOCK_NS:
                yield buffer.cut(start_ns, covered_ns)
                start_ns = covered_ns
