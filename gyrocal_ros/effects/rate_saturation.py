"""The sensor cannot read faster turns than its range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.recording import GyroReadings
from gyrocal_ros.model.sensor import (
    Coefficient,
    DetectedLimit,
    GyroTerm,
    Memory,
    Place,
    TypicalRange,
    with_means,
)

AT_LIMIT = 0.98
"""Part of the limit from which readings count as clipped: limits of the two sides that differ by less, by the
offset of the sensor, count as one."""
WHEEL_TURN_ERROR = 0.1
"""Relative standard deviation of the wheels' turn, which replaces the clipped reading."""
TOP_PART = 0.98
"""Fraction of the largest reading above which readings count as equal to it."""
MIN_TOP_S = 0.5
"""Minimum time with readings at the largest one for a limit to be possible."""
OUTLIERS = 20
"""Number of largest readings that are ignored: noise on top of a limit."""
BEYOND = 1.05
"""Limit of a side that has none, relative to its largest reading."""
REPEATED, TIMES_OTHERS = 50, 20
"""Number of equal readings at a limit which proves it, and relative to the number at any other value below:
a robot that turns at one rate is read with noise, or with all values as coarse."""
PASSED_SIGMA = 5.0
"""Standard deviations of the noise beyond which a reading has passed a limit: then it is none."""


@dataclass(frozen=True)
class RateSaturation:
    """Rates beyond `limit` are read as the limit; the rest is taken from wheels and camera.

    The limit is detected in the readings, not estimated, because nothing in the model depends on it smoothly.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='Beyond its range the sensor outputs its largest value and no more. However fast the '
        'turn, the reading stays at the limit, and the part beyond is lost. For such moments the '
        'wheels and the camera have to measure how far the robot turned.',
        equation='|w_n - offset| <= limit, else by the wheels',
        usual_size='60 to 300 deg/s',
        best_motion='turns faster than the range of the sensor',
        twins=('scale_cubic', 'scale_factor'),
        source='IEEE Std 528, Inertial Sensor Terminology: input limits',
        may_break_the_filter=True,
        example=(math.radians(60.0),),
        shown_against='rate',
    )
    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'rate_saturation'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'limit',
            'rad/s',
            prior_std=0.0,
            prior_mean=math.radians(300.0),
            typical=TypicalRange(math.radians(85.0), math.radians(50.0), signed=False),
        ),
    )
    offset_rad_s: float = 0.0
    """Middle of the limits of the two sides: the zero of a sensor may lie beside the middle of its range."""

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Replace a clipped rate by that of the wheels, with its standard deviation."""
        rate = block.rate_rad_s[:, 2]
        clipped = np.abs(rate - self.offset_rad_s) >= AT_LIMIT * values[0]
        by_wheels = block.wheel_turn_rad / block.dt_s
        beyond = np.maximum(np.abs(by_wheels) - np.abs(rate), 0.0) * np.sign(rate)
        noise = WHEEL_TURN_ERROR * np.maximum(np.abs(by_wheels), np.abs(rate))
        return GyroTerm(
            np.where(clipped, beyond, 0.0),
            np.zeros((len(rate), 1)),
            noise_rad_s=np.where(clipped, noise, 0.0),
            blind=clipped,
        )

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Clip the readings at the limit, to both sides."""
        return np.clip(nominal_rad_s, self.offset_rad_s - values[0], self.offset_rad_s + values[0])

    def detect(self, readings: GyroReadings) -> DetectedLimit | None:
        """Find the rate at which the largest readings accumulate: a limit, or the usual turning rate."""
        limit = _accumulation(np.abs(readings.rate_rad_s), readings)
        if limit is None:
            return None
        if any(_passed(side * readings.rate_rad_s, limit) > OUTLIERS for side in (1.0, -1.0)):
            return None
        return DetectedLimit(limit, _is_repeated(readings.rate_rad_s, limit))

    def of_each_side(self, readings: GyroReadings) -> RateSaturation | None:
        """Return limits of both sides that differ, as readings of each accumulate; one side may have none.

        None if both sides have the same limit, or none, or if the slower one has none.
        """
        sides = readings.rate_rad_s, -readings.rate_rad_s
        found = [_limit_of_side(rate, readings) for rate in sides]
        if found == [None, None]:
            return None
        pairs = zip(sides, found, strict=True)
        left, right = (BEYOND * _largest(rate) if limit is None else limit for rate, limit in pairs)
        is_one = min(left, right) > AT_LIMIT * max(left, right)
        if is_one or min(left, right) not in found:
            return None
        return replace(with_means(self, (0.5 * (left + right),)), offset_rad_s=0.5 * (left - right))

    def rate_error(self, rate_rad_s: Array, limit: float) -> tuple[Array, Array]:
        """Return the sign of readings at the limit: there the turn is underestimated by an unknown amount."""
        side = np.where(np.abs(rate_rad_s - self.offset_rad_s) >= TOP_PART * limit, np.sign(rate_rad_s), 0.0)
        return side, np.zeros_like(side)

    def is_plausible(self, readings: GyroReadings, limit: float) -> bool:
        """Return True: no reading can contradict the limit."""
        return True


def _limit_of_side(rate_rad_s: Array, readings: GyroReadings) -> float | None:
    """Return the rate at which the largest of the readings (n,), positive to one side, accumulate."""
    limit = _accumulation(np.maximum(rate_rad_s, 0.0), readings)
    return None if limit is None or _passed(rate_rad_s, limit) > OUTLIERS else limit


def _largest(rate_rad_s: Array) -> float:
    """Return the largest of the rates (n,) but for outliers."""
    return float(np.partition(rate_rad_s, -OUTLIERS)[-OUTLIERS])


def _accumulation(size_rad_s: Array, readings: GyroReadings) -> float | None:
    """Return the rate at which the largest of the rates (n,) accumulate; None where they do not."""
    if len(size_rad_s) <= OUTLIERS:
        return None
    top = TOP_PART * _largest(size_rad_s)
    rate_hz = NS_PER_S / float(np.median(np.diff(readings.t_ns)))
    at_top = size_rad_s[size_rad_s > top]
    return float(np.median(at_top)) if len(at_top) > OUTLIERS + MIN_TOP_S * rate_hz else None


def _is_repeated(rate_rad_s: Array, limit: float) -> bool:
    """Return True if one value of the readings (n,) at a limit is repeated far more often than any below it.

    Zero does not count: there may be a dead band besides.
    """
    values, counts = np.unique(rate_rad_s[rate_rad_s != 0.0], return_counts=True)
    is_top = np.abs(values) > TOP_PART * limit
    at_top, below = counts[is_top].max(initial=0), counts[~is_top].max(initial=1)
    return bool(at_top >= max(REPEATED, TIMES_OTHERS * below))


def _passed(rate_rad_s: Array, limit: float) -> int:
    """Return the number of readings (n,) of one side that exceed its limit, which is about that of both."""
    is_top = rate_rad_s > TOP_PART * limit
    steps = np.diff(rate_rad_s)[is_top[1:] & is_top[:-1]]
    if not len(steps):
        return 0
    noise_rad_s = math.sqrt(0.5 * float(np.mean(steps**2)))
    own_limit = float(np.median(rate_rad_s[is_top]))
    return int(np.sum(rate_rad_s > own_limit + PASSED_SIGMA * noise_rad_s))
