"""Low passes of first order: of references that smooth their headings, and of gyros that lag.

A low pass of the headings delays a steady turn, which looks like a late stamp, and rounds its beginning and
end. The turn by the gyro behind the same low pass does both, so its time constant is found by maximum
likelihood. Where the gyro is behind a low pass, it is the same with both in each other's place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, HeadingSample, ImuSample, Measurement, nanoseconds
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.noise.reference_noise import ReferenceNoise
from gyrocal_ros.pipeline.reference_fit import HeadingTrack, ReferenceFit, log_likelihood_of

TIME_CONSTANTS_S = (0.01, 0.03, 0.1, 0.3)
"""Time constants that are tried first."""
RATIOS, BESIDE = (2.0, 1.4, 1.2, 1.1, 1.05, 1.02, 1.01, 1.005), 0.1
"""Steps by which the best is then improved, and distance from it at which the likelihood gives its standard
deviation, both relative."""
MIN_GAIN = 18.0
"""Gain of log-likelihood from which there is a low pass: six standard deviations, because other things that
the fit neglects look a little like it."""
PARTS, LEAST_GAIN = (0.3, 0.5, 0.7, 0.85), 0.5
"""Time constants relative to the best, and what they gain at least relative to theory."""


@dataclass(frozen=True, slots=True)
class LowPass:
    """A low pass of first order that is there for certain."""

    time_constant_s: float
    std_s: float
    """Its standard deviation; that of the time offset beside it is as large."""
    gain: float
    """Log-likelihood that it gains."""


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


def find_low_pass(
    track: Callable[[float], HeadingTrack], noise: ReferenceNoise, gyro: GyroConfig
) -> LowPass | None:
    """Return the likeliest low pass; None where none explains enough.

    Args:
        track: returns the headings beside the gyro with a low pass of that time constant, the same number for
            each.
        noise: noise of the headings without one.
        gyro: noise of the gyro.
    """
    found: dict[float, float] = {}

    def likelihood(time_constant_s: float) -> float:
        if time_constant_s not in found:
            found[time_constant_s] = log_likelihood_of(track(time_constant_s), noise, gyro)
        return found[time_constant_s]

    without = likelihood(0.0)
    best_s = max(TIME_CONSTANTS_S, key=likelihood)
    if likelihood(best_s) <= without:
        return None
    for ratio in RATIOS:
        best_s = max((best_s / ratio, best_s, best_s * ratio), key=likelihood)
    gain = likelihood(best_s) - without
    # What a low pass rounds goes with the square of its time constant, so the gain is a parabola over that. A
    # jump near a turn gains at a few time constants only.
    is_low_pass = all(
        likelihood(part * best_s) - without > LEAST_GAIN * (1.0 - (1.0 - part**2) ** 2) * gain
        for part in PARTS
    )
    if gain <= MIN_GAIN or not is_low_pass:
        return None
    lost = sum(likelihood(best_s) - likelihood(best_s * ratio) for ratio in (1.0 - BESIDE, 1.0 + BESIDE))
    information = max(lost / (BESIDE * best_s) ** 2, 1.0 / best_s**2)
    return LowPass(best_s, 1.0 / math.sqrt(information), gain)


def with_true_headings(
    measurements: Iterable[Measurement], fitted: ReferenceFit, *, lags: bool
) -> Iterator[Measurement]:
    """Yield the measurements with the headings corrected, sorted on each time base.

    Args:
        measurements: of gyro and reference.
        fitted: fit of the reference.
        lags: True for headings that lag as the gyro does.
    """
    on_base: list[Measurement] = []
    for sample in measurements:
        if isinstance(sample, ClockStep):
            yield from sorted(_corrected(on_base, fitted, lags=lags), key=attrgetter('t_ns'))
            yield sample
            on_base.clear()
        else:
            on_base.append(sample)
    yield from sorted(_corrected(on_base, fitted, lags=lags), key=attrgetter('t_ns'))


def _corrected(measurements: list[Measurement], fitted: ReferenceFit, *, lags: bool) -> list[Measurement]:
    """Return the measurements of a time base with stamps and headings corrected."""
    offset_ns = nanoseconds(fitted.time_offset_s)
    on_time = [
        replace(item, t_ns=item.t_ns - offset_ns) if isinstance(item, HeadingSample) else item
        for item in measurements
    ]
    imu = [(item.t_ns, item.rate_rad_s[2]) for item in measurements if isinstance(item, ImuSample)]
    time_constant_s, lag_s = fitted.time_constant_s, fitted.gyro_lag_s if lags else 0.0
    if time_constant_s == lag_s or len(imu) < 2:
        return on_time
    start_ns = imu[0][0]
    time_s = np.array([t_ns - start_ns for t_ns, _ in imu]) / NS_PER_S
    rate = np.array([rate for _, rate in imu])
    turned = turned_rad(time_s, rate)
    smooth = low_passed(time_s, turned, time_constant_s)

    def corrected(sample: HeadingSample) -> HeadingSample:
        at_s = (sample.t_ns - start_ns) / NS_PER_S
        rounded_rad = np.interp(at_s, time_s, turned) - np.interp(at_s + time_constant_s, time_s, smooth)
        ahead_rad = lag_s * np.interp(at_s, time_s, rate)
        turn_rad = fitted.scale_factor * float(rounded_rad - ahead_rad)
        return replace(sample, yaw_rad=sample.yaw_rad + turn_rad)

    return [corrected(item) if isinstance(item, HeadingSample) else item for item in on_time]
