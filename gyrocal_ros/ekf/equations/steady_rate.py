"""The rate that the gyro really had: the reading without its noise, where it is steady.

The scale factor multiplies the true nominal rate, and the filter knows only the reading. While the robot
drives straight, the reading is noise. A derivative by the scale factor that is built from it regresses no
rotation on noise: the estimate is pulled towards no scale factor at all, with false confidence (errors in
variables). So the derivatives are taken at a rate whose error is independent of the noise of the block. The
same holds for the vibration: as an instrumental variable, that of the blocks before takes its place.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array, MotionBlock, changed, constant
from gyrocal_ros.ekf.equations.effects_by_place import EffectsByPlace
from gyrocal_ros.kernels import compiled

CHANGE_SIGMA = 3.0
"""Change of the mean rate from which it is real."""
MEMORY = 10
"""Number of blocks over which rate and noise are averaged."""
VIBRATION_RAD_S = math.radians(2.0)
"""Change of the mean rate up to which a robot whose wheels stand still vibrates; beyond, a hand turns it."""
VIBRATION_BLOCKS = 5
"""Number of blocks before, but for the last, whose vibration stands for that of a block."""
NOISE_BLOCKS = 50
"""Number of last blocks by whose median the noise of the gyro is judged."""
NOISY = 2.0
"""Noise of the gyro, relative to that of the settings, from which its own noise is used."""
IRREGULAR = 0.5
"""Standard deviation of the intervals between samples, relative to their mean, from which stamps err."""


class SteadyRate:
    """Follows the yaw rate: its running mean while it is steady, the reading itself while it changes."""

    def __init__(self) -> None:
        self._mean_rad_s: float | None = None
        self._blocks = 0
        self._end_rad_s: float | None = None
        self.change_rad_s = 0.0
        """Change of the mean rate to the last block; zero while it is steady."""
        self.tilt_noise_rad_s: Sequence[float] | None = None
        """(2,) noise of the x and y gyros, of settings or readings; None as long as the readings are few."""
        self._was_at_rest = False
        self._noise_rad2_s: float | None = None
        self._seen_rad2_s = tuple(_LastMedian() for _ in range(3))
        self._vibrations_m2_s4: deque[float] = deque(maxlen=VIBRATION_BLOCKS + 1)

    def with_noise(self, block: MotionBlock, gyro: GyroConfig, effects: EffectsByPlace) -> GyroConfig:
        """Return the settings, with the noise of the yaw gyro where its readings show far more than is known.

        Second differences of the readings show it: they contain neither the rate nor its steady change. Where
        stamps are irregular, samples are out of place while the rate changes, and those of this block count.
        Each axis has its own noise, see `tilt_noise_rad_s` for the others.

        Args:
            block: the block.
            gyro: settings.
            effects: those of the model; noise among them is known.
        """
        _, _, bends_rad2_s, irregularity = rate_scatter(block.rate_rad_s, block.dt_s)
        if len(block.dt_s) > 2:
            # An interval's rate is the mean of two readings r: its bend is (r3 - r2 - r1 + r0) / 2.
            for seen, bends in zip(self._seen_rad2_s, bends_rad2_s.tolist(), strict=True):
                seen.add(bends)
        if not self._seen_rad2_s[0].is_full:
            return gyro
        x_rad2_s, y_rad2_s, z_rad2_s = (
            max(seen.median, seen.last) if irregularity > IRREGULAR else seen.median
            for seen in self._seen_rad2_s
        )
        set_rad2_s = math.radians(gyro.rate_noise_deg_s) ** 2
        tilt_rad2_s = [seen if _is_noisy(seen, set_rad2_s) else set_rad2_s for seen in (x_rad2_s, y_rad2_s)]
        self.tilt_noise_rad_s = [*map(math.sqrt, tilt_rad2_s)]
        by_effects_rad2_s = _noise_of(effects, block.rate_rad_s[:, 2])
        if not _is_noisy(z_rad2_s, set_rad2_s + by_effects_rad2_s):
            return gyro
        return replace(gyro, rate_noise_deg_s=math.degrees(math.sqrt(z_rad2_s - by_effects_rad2_s)))

    def without_noise(self, block: MotionBlock, gyro: GyroConfig, *, is_at_rest: bool = False) -> MotionBlock:
        """Return the block with the yaw rate and acceleration at which derivatives are taken; remember it.

        Args:
            block: the block.
            gyro: noise of the gyro.
            is_at_rest: True for a robot that stands still: small changes are vibration then.
        """
        mean, steps_rad2_s, _, _ = rate_scatter(block.rate_rad_s, block.dt_s)
        std = math.sqrt(self._noise(len(block.dt_s), 0.5 * steps_rad2_s, gyro) / block.duration_s)
        before = self._mean_rad_s
        largest = CHANGE_SIGMA * std * math.sqrt(1.0 + 1.0 / max(self._blocks, 1))
        if is_at_rest and self._was_at_rest:
            largest = max(largest, VIBRATION_RAD_S)
        self._was_at_rest = is_at_rest
        vibration = self._vibration_before(block)
        is_steady = before is not None and abs(mean - before) <= largest
        self.change_rad_s = 0.0 if before is None or is_steady else mean - before
        if before is None or not is_steady:
            self._mean_rad_s, self._blocks = mean, 1
            acceleration = self._acceleration(block)
            return changed(block, yaw_acceleration_rad_s2=acceleration, vibration_m2_s4=vibration)
        self._blocks = self._blocks + 1 if is_at_rest else min(self._blocks + 1, MEMORY)
        self._mean_rad_s = before + (mean - before) / self._blocks
        rates = block.rate_rad_s.copy()
        rates[:, 2] = before
        acceleration = self._steady_acceleration(block, before)
        return changed(
            block, rate_rad_s=rates, yaw_acceleration_rad_s2=acceleration, vibration_m2_s4=vibration
        )

    def _acceleration(self, block: MotionBlock) -> Array:
        """Return the yaw acceleration (N,) of a block in which the rate changes, by its readings.

        It starts from the rate at which the block before ended, so that the rate is its sum.
        """
        acceleration, rates = block.yaw_acceleration_rad_s2, block.rate_rad_s[:, 2]
        half_rad_s = 0.5 * acceleration * block.dt_s
        start_rad_s, before_rad_s = float(rates[0] - half_rad_s[0]), self._end_rad_s
        self._end_rad_s = float(rates[-1] + half_rad_s[-1])
        if before_rad_s is None:
            return acceleration
        return acceleration + (start_rad_s - before_rad_s) / block.duration_s

    def _steady_acceleration(self, block: MotionBlock, before_rad_s: float) -> Array:
        """Return the yaw acceleration (N,) of a block in which the rate is steady, by the mean before it.

        That by the readings is noise. Regressed on it, a lag of the gyro is pulled towards none.
        """
        assert self._end_rad_s is not None
        change_rad_s, self._end_rad_s = before_rad_s - self._end_rad_s, before_rad_s
        return constant(change_rad_s / block.duration_s, len(block.dt_s))

    def _vibration_before(self, block: MotionBlock) -> Array:
        """Return the mean vibration (N,) of the blocks before, and remember that of this one.

        The last one is left out, since the estimate of this block still contains some of its samples.
        """
        known = [*self._vibrations_m2_s4]
        self._vibrations_m2_s4.append(float(block.vibration_m2_s4[0]))
        if len(known) <= VIBRATION_BLOCKS:
            return block.vibration_m2_s4
        return constant(sum(known[:-1]) / VIBRATION_BLOCKS, len(block.dt_s))

    def _noise(self, count: int, seen_rad2_s: float, gyro: GyroConfig) -> float:
        """Return the white noise of the rate as a density, (rad/s)^2/Hz: that of the settings or more.

        Differences of neighbouring readings show it, and hardly the motion.
        """
        if count > 1:
            known = self._noise_rad2_s
            self._noise_rad2_s = seen_rad2_s if known is None else known + (seen_rad2_s - known) / MEMORY
        return max(math.radians(gyro.rate_noise_deg_s) ** 2, self._noise_rad2_s or 0.0)


def with_acceleration(block: MotionBlock, steady: MotionBlock) -> MotionBlock:
    """Return a block with the yaw acceleration of another: at rest its own is noise."""
    return changed(block, yaw_acceleration_rad_s2=steady.yaw_acceleration_rad_s2)


class _LastMedian:
    """The median of the last `NOISE_BLOCKS` numbers."""

    def __init__(self) -> None:
        self._numbers: deque[float] = deque(maxlen=NOISE_BLOCKS)
        self._sorted: list[float] = []

    def add(self, number: float) -> None:
        """Remember one more number, in order of time and in order of size."""
        if self.is_full:
            del self._sorted[bisect_left(self._sorted, self._numbers[0])]
        self._numbers.append(number)
        insort(self._sorted, number)

    @property
    def is_full(self) -> bool:
        """True once there are as many numbers as are kept."""
        return len(self._numbers) == NOISE_BLOCKS

    @property
    def median(self) -> float:
        """Median of the numbers."""
        middle = NOISE_BLOCKS // 2
        return 0.5 * (self._sorted[middle - 1] + self._sorted[middle])

    @property
    def last(self) -> float:
        """The latest number."""
        return self._numbers[-1]


def _is_noisy(seen_rad2_s: float, known_rad2_s: float) -> bool:
    """Return True if a noise, (rad/s)^2/Hz, is far above the one that is known."""
    return seen_rad2_s >= NOISY**2 * known_rad2_s


def _noise_of(effects: EffectsByPlace, rate_rad_s: Array) -> float:
    """Return the mean white noise, (rad/s)^2/Hz, that effects add at readings (N,) of the yaw rate."""
    return sum(
        float(np.mean(effect.density(rate_rad_s, effects.prior_means[place]) ** 2))
        for effect, place in effects.noise
    )


@compiled
def rate_scatter(rate_rad_s: Array, dt_s: Array) -> tuple[float, float, Array, float]:
    """Return the mean of the yaw rate over N intervals, and how rates and intervals scatter.

    Args:
        rate_rad_s: (N, 3)
        dt_s: (N,)

    Returns:
        Mean rate (rad/s); mean square of its first differences, times the mean interval ((rad/s)^2/Hz), 0
        with too few; the same of the second differences of each axis (3,); standard deviation of the
        intervals inside the block, relative to their mean, 0 with fewer than three.
    """
    rates, inside_s, interval_s = rate_rad_s[:, 2], dt_s[1:-1], float(dt_s.mean())
    steps = rates[1:] - rates[:-1]
    bends = rate_rad_s[2:] - 2.0 * rate_rad_s[1:-1] + rate_rad_s[:-2]
    return (
        float(rates @ dt_s) / float(dt_s.sum()),
        float(steps @ steps) / len(steps) * interval_s if len(steps) else 0.0,
        np.square(bends).mean(axis=0) * interval_s if len(bends) else np.zeros(3),
        float(inside_s.std()) / float(inside_s.mean()) if len(inside_s) > 2 else 0.0,
    )
