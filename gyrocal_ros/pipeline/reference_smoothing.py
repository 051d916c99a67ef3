"""Heading references that smooth their headings, by a low pass of first order.

Such a low pass delays a steady turn, which looks like a late stamp, and rounds its beginning and end. The
turn by the gyro behind the same low pass does both, so its time constant is found by maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from operator import attrgetter

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, HeadingSample, ImuSample, Measurement, nanoseconds
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.noise.reference_noise import ReferenceNoise
from gyrocal_ros.pipeline.reference_fit import HeadingTrack, log_likelihood_of

TIME_CONSTANTS_S = (0.03, 0.1, 0.3)
"""Time constants that are tried first."""
RATIOS = (2.0, 1.4, 1.2, 1.1)
"""Steps by which the best is then improved."""
MIN_GAIN = 18.0
"""Gain of log-likelihood from which a reference smooths its headings: six standard deviations, because other
things that the fit neglects look a little like it."""


def turned_rad(time_s: Array, rate_rad_s: Array) -> Array:
    """Return the integral (n,) of a rate; nothing is known of pauses."""
    interval_s = np.diff(time_s)
    turns = np.where(
        interval_s > PAUSE_NS / NS_PER_S, 0.0, 0.5 * (rate_rad_s[1:] + rate_rad_s[:-1]) * interval_s
    )
    return np.concatenate([[0.0], np.cumsum(turns)])


def low_passed(time_s: Array, values: Array, time_constant_s: float) -> Array:
    """Return values (n,), linear between their times, behind a low pass of first order."""
    if time_constant_s == 0.0 or len(values) < 2:
        return values
    interval_s = np.diff(time_s)
    behind = time_constant_s * np.diff(values) / interval_s  # by which a steady slope is late
    kept = np.exp(-interval_s / time_constant_s)
    late, lateness = 0.0, [0.0]
    for slope, part in zip(behind.tolist(), kept.tolist(), strict=True):
        late = slope + (late - slope) * part
        lateness.append(late)
    return values - np.array(lateness)


def find_time_constant(
    track: Callable[[float], HeadingTrack], noise: ReferenceNoise, gyro: GyroConfig
) -> float:
    """Return the likeliest time constant of the low pass; 0 where none explains enough.

    Args:
        track: returns the headings beside the gyro behind a low pass of that time constant.
        noise: noise of the headings without one.
        gyro: noise of the gyro.
    """

    def likelihood(time_constant_s: float) -> float:
        return log_likelihood_of(track(time_constant_s), noise, gyro)

    without = likelihood(0.0)
    found = {time_s: likelihood(time_s) for time_s in TIME_CONSTANTS_S}
    best_s = max(found, key=lambda time_s: found[time_s])
    if found[best_s] <= without:
        return 0.0
    for ratio in RATIOS:
        found |= {time_s: likelihood(time_s) for time_s in (best_s / ratio, best_s * ratio)}
        best_s = max(found, key=lambda time_s: found[time_s])
    return best_s if found[best_s] > without + MIN_GAIN else 0.0


def with_true_headings(
    measurements: Iterable[Measurement], offset_s: float, time_constant_s: float, scale_factor: float
) -> Iterator[Measurement]:
    """Yield the measurements with the headings corrected, sorted on each time base.

    Args:
        measurements: of gyro and reference.
        offset_s: stamp minus true time, the delay of the low pass included.
        time_constant_s: of the low pass; 0 for none.
        scale_factor: of the gyro, roughly.
    """
    correction = offset_s, time_constant_s, scale_factor
    on_base: list[Measurement] = []
    for sample in measurements:
        if isinstance(sample, ClockStep):
            yield from sorted(_corrected(on_base, *correction), key=attrgetter('t_ns'))
            yield sample
            on_base.clear()
        else:
            on_base.append(sample)
    yield from sorted(_corrected(on_base, *correction), key=attrgetter('t_ns'))


def _corrected(
    measurements: list[Measurement], offset_s: float, time_constant_s: float, scale_factor: float
) -> list[Measurement]:
    """Return the measurements of a time base with stamps and smoothing of the headings corrected."""
    on_time = [
        replace(item, t_ns=item.t_ns - nanoseconds(offset_s)) if isinstance(item, HeadingSample) else item
        for item in measurements
    ]
    imu = [(item.t_ns, item.rate_rad_s[2]) for item in measurements if isinstance(item, ImuSample)]
    if time_constant_s == 0.0 or len(imu) < 2:
        return on_time
    start_ns = imu[0][0]
    time_s = np.array([t_ns - start_ns for t_ns, _ in imu]) / NS_PER_S
    turned = turned_rad(time_s, np.array([rate for _, rate in imu]))
    smooth = low_passed(time_s, turned, time_constant_s)

    def sharpened(sample: HeadingSample) -> HeadingSample:
        at_s = (sample.t_ns - start_ns) / NS_PER_S
        rounded_rad = np.interp(at_s, time_s, turned) - np.interp(at_s + time_constant_s, time_s, smooth)
        return replace(sample, yaw_rad=sample.yaw_rad + scale_factor * float(rounded_rad))

    return [sharpened(item) if isinstance(item, HeadingSample) else item for item in on_time]
