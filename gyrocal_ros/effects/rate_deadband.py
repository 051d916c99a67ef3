"""The sensor reads very small rates as zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, MotionBlock
from gyrocal_ros.effects.base import Explanation
from gyrocal_ros.model.recording import GyroReadings
from gyrocal_ros.model.sensor import Coefficient, DetectedLimit, GyroTerm, Memory, Place, TypicalRange

SLOW_RAD_S = math.radians(2.0)
"""Upper bound of the readings that are searched for a repeated value."""
MIN_DISTINCT = 4
"""Minimum number of distinct slow readings."""
STUCK_PART = 0.05
"""Minimum fraction of the slow readings that have the same value."""
GAP_STEPS = 3.0
"""Minimum distance of the next readings from the stuck value, in usual steps; a coarse converter has
even steps."""
MEAN_S, MEANS = 0.1, 10
"""Noise inside the band is estimated from means over 0.1 s, ten in each second."""
MIN_SECONDS = 10
"""Minimum number of such seconds; of fewer the mean alone is judged."""
MAX_EDGE_PART = 0.5
"""Largest mean of the readings inside, as a part of the width, where such seconds are few. A bias near an
edge is inside now and then because of the noise, and the mean is near the edge, too."""
MAX_SPREAD_PART, MAX_SPREAD_RATIO = 0.45, 1.5
"""Largest rms of the means inside, as a part of the width, and relative to what the noise of single readings
explains. Rates that are read fill the width: slow turns or a swing have an rms of more than half of it."""
MAX_VARIANCE_RATIO = 3.0
"""Largest variance of the means over a second, relative to what their noise explains, of dead readings."""
NEAR_SAMPLES = 7
"""Number of readings whose mean decides whether the rate is inside the band: one alone is mostly noise."""
INSIDE_STD = 0.5
"""Standard deviation of the rate inside the band, as a part of its width: nearly that of a uniform
distribution. A robot drives straight far more often than it turns so slowly, but it wanders for seconds."""
MAX_MEAN_SIGMA, MAX_MEAN_PART = 5.0, 0.02
"""Largest mean of dead readings: in its standard deviations, and besides as a part of the width. Else the
readings hold a bias, which a dead band does not let through."""
_WIDTHS_RAD_S = tuple(math.radians(width) for width in (0.1, 0.2, 0.3, 0.4, 0.5))


@dataclass(frozen=True)
class RateDeadband:
    """Rates below `width` are read as zero: the true rate is anywhere in the band, most often near zero.

    As with saturation, the width is detected in the readings and not estimated. The wheels tell no more:
    where they differ in size, they turn by as much as the band is wide, and their steps are wider.
    """

    about: ClassVar[Explanation] = Explanation(
        physics='Small readings are set to zero, by friction in the sensing element, by coarse steps '
        'of the converter or by firmware that wants a robot at rest to stand still. Slow turning and '
        'slow drift are then not measured, and neither is the bias itself.',
        equation='w_n = 0 where |w_n| < width',
        usual_size='0.05 to 0.5 deg/s',
        best_motion='very slow turns and long gentle arcs to both sides',
        twins=('bias',),
        source='IEEE Std 528, Inertial Sensor Terminology: dead band',
        example=(math.radians(0.3),),
        shown_against='slow rate',
    )
    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'rate_deadband'
    coefficients: tuple[Coefficient, ...] = (
        Coefficient(
            'width',
            'rad/s',
            prior_std=0.0,
            scan=_WIDTHS_RAD_S,
            typical=TypicalRange(math.radians(0.1), math.radians(0.5), signed=False),
        ),
    )

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Replace the rate within the band by zero, which it is for certain where the wheels stand still."""
        rate, width = block.rate_rad_s[:, 2], values[0]
        inside = _is_inside(rate, width)
        noise_rad_s = 0.0 if block.wheels_at_rest else INSIDE_STD * width
        return GyroTerm(
            np.where(inside, -rate, 0.0),
            np.zeros((len(rate), 1)),
            noise_rad_s=np.where(inside, noise_rad_s, 0.0),
            blind=inside,
        )

    def readings(self, nominal_rad_s: Array, dt_s: Array, values: Array, scale_factor: float) -> Array:
        """Set readings within the band to zero."""
        return np.where(np.abs(nominal_rad_s) < values[0], 0.0, nominal_rad_s)

    def detect(self, readings: GyroReadings) -> DetectedLimit | None:
        """Find the width of the empty band around one value that is read again and again."""
        slow = readings.rate_rad_s[np.abs(readings.rate_rad_s) < SLOW_RAD_S]
        values, counts = np.unique(slow, return_counts=True)
        if len(values) < MIN_DISTINCT:
            return None
        place = int(np.argmax(counts))
        if not 0 < place < len(values) - 1 or counts[place] < STUCK_PART * counts.sum():
            return None
        gaps = np.diff(values)
        width = float(min(gaps[place - 1], gaps[place]))
        usual = float(np.median(np.delete(gaps, [place - 1, place])))
        return DetectedLimit(width, is_certain=True) if width > GAP_STEPS * usual else None

    def rate_error(self, rate_rad_s: Array, limit: float) -> tuple[Array, Array]:
        """Return the meaningless reading inside the band, and the bias that is added to it, as errors."""
        inside = _is_inside(rate_rad_s, limit).astype(float)
        return -inside * rate_rad_s, -inside

    def is_plausible(self, readings: GyroReadings, limit: float) -> bool:
        """Check that the readings inside are zero: they follow no bias and no slow turns."""
        count = max(round(MEAN_S * NS_PER_S / float(np.median(np.diff(readings.t_ns)))), 1)
        rate = readings.rate_rad_s[: len(readings.rate_rad_s) // (MEANS * count) * MEANS * count]
        rate = rate.reshape(-1, MEANS, count)
        means = rate.mean(axis=2)
        is_inside = np.abs(means) < limit
        inside, pieces = means[np.all(is_inside, axis=1)], means[is_inside]
        if len(inside) < MIN_SECONDS:
            if MEAN_S * len(pieces) < MIN_SECONDS:
                return True
            steps = np.diff(rate[is_inside], axis=1)
            by_noise = math.sqrt(0.5 * float(np.mean(steps**2)) / count) if count > 1 else 0.0
            spread = max(MAX_SPREAD_PART * limit, MAX_SPREAD_RATIO * by_noise)
            is_zero = abs(float(pieces.mean())) <= MAX_EDGE_PART * limit
            return is_zero and math.sqrt(float(np.mean(pieces**2))) <= spread
        noise = 0.5 * float(np.mean(np.diff(inside, axis=1) ** 2)) / MEANS
        is_constant = float(np.var(inside.mean(axis=1))) <= MAX_VARIANCE_RATIO * noise
        largest = MAX_MEAN_SIGMA * math.sqrt(noise / len(inside)) + MAX_MEAN_PART * limit
        return is_constant and abs(float(inside.mean())) <= largest


def _is_inside(rate_rad_s: Array, width: float) -> Array:
    """Return True (n,) for readings of a rate inside the band.

    The mean of neighbours decides. Where readings are exactly zero, the sensor set its own noise to zero,
    too, and those beyond the width are real; elsewhere noise was added to the zeros, and they are not.
    """
    padded = np.pad(rate_rad_s, NEAR_SAMPLES // 2, mode='symmetric')
    mean = np.convolve(padded, np.full(NEAR_SAMPLES, 1.0 / NEAR_SAMPLES), mode='valid')
    small = np.abs(rate_rad_s) < width
    return np.logical_and(np.abs(mean) < width, small if np.any(rate_rad_s == 0.0) else True)
