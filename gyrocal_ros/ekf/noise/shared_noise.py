"""Does a heading reference contain the gyro that it is to calibrate?

Localisation that fuses the gyro, and the orientation by the IMU itself, repeat the noise of the gyro: their
turns correlate with it. The turns of an independent reference correlate with the true turns alone. So the
slope of the turns of the reference on those of the gyro is compared, while the robot hardly turns, with the
share of true turns in the variance of the gyro, which is what its white noise does not explain.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.data import Array, MotionBlock

INTERVAL_S = 0.25
"""Shortest turn that is compared: far longer than the delay of the reference."""
LOST_S = 5.0
"""Time without headings after which the comparison starts again."""
TURNS = 8
"""Number of turns in a window; each is compared with their mean."""
QUIET = 4.0
"""Variance of the turns in a window in which the robot hardly turns, relative to that by white noise."""
MIN_WINDOWS = 3
SIGMA, MARGIN = 3.5, 0.1
"""Standard deviations, and share beyond, by which a slope has to exceed that of an independent reference."""


class SharedNoise:
    """Compares the turns of a reference with those of the gyro."""

    def __init__(self) -> None:
        self._rates_rad_s: list[Array] = []
        self._times_s: list[Array] = []
        self._turn_rad = self._time_s = 0.0
        self._turns: list[tuple[float, float]] = []
        self._before_rad: float | None = None
        self._sums = np.zeros((2, 2))
        self._white_rad2, self._windows = 0.0, 0

    def move(self, block: MotionBlock) -> None:
        """Follow one block of the gyro."""
        if block.gap_s > 0.0 or self._time_s > LOST_S:
            self._begin()
        if self._before_rad is None:
            return
        self._rates_rad_s.append(block.rate_rad_s[:, 2])
        self._times_s.append(block.dt_s)
        self._turn_rad += float(block.rate_rad_s[:, 2] @ block.dt_s)
        self._time_s += block.duration_s

    def add(self, yaw_rad: float) -> None:
        """Take the heading (rad) of the reference at the end of the last block."""
        if self._before_rad is None:
            self._begin()
            self._before_rad = yaw_rad
        elif self._time_s >= INTERVAL_S:
            turned_rad = math.remainder(yaw_rad - self._before_rad, 2.0 * math.pi)
            self._turns.append((self._turn_rad, turned_rad))
            self._before_rad, self._turn_rad, self._time_s = yaw_rad, 0.0, 0.0
            if len(self._turns) == TURNS:
                self._judge()

    @property
    def slope(self) -> tuple[float, float]:
        """Slope of the turns of the reference on those of the gyro, and its standard deviation."""
        (of_gyro, of_both), (_, of_reference) = self._sums.tolist()
        if self._windows < MIN_WINDOWS or of_gyro == 0.0:
            return 0.0, math.inf
        slope = of_both / of_gyro
        freedom = self._windows * (TURNS - 1) - 1
        return slope, math.sqrt(max(of_reference / of_gyro - slope**2, 0.0) / freedom)

    @property
    def true_share(self) -> float:
        """Share of true turns in the variance of the gyro: the slope of an independent reference."""
        return 1.0 - min(self._white_rad2 / float(self._sums[0, 0]), 1.0)

    @property
    def is_shared(self) -> bool:
        """True if the reference repeats the noise of the gyro."""
        slope, std = self.slope
        return slope - SIGMA * std > MARGIN and slope - SIGMA * std > self.true_share + MARGIN

    def _judge(self) -> None:
        """Add a window in which the robot hardly turns to the sums, and begin the next."""
        turns = np.array(self._turns)
        turns -= turns.mean(axis=0)
        products = turns.T @ turns
        white_rad2 = (TURNS - 1) * self._white_rad2_of_a_turn()
        if 0.0 < products[0, 0] <= QUIET * white_rad2:
            self._sums += products
            self._white_rad2 += white_rad2
            self._windows += 1
        before_rad = self._before_rad
        self._begin()
        self._before_rad = before_rad

    def _white_rad2_of_a_turn(self) -> float:
        """Return the variance of a turn by the white noise that the second differences of the rate show."""
        rate, dt_s = np.concatenate(self._rates_rad_s), np.concatenate(self._times_s)
        if len(rate) < TURNS:
            return 0.0
        # An interval's rate is the mean of two readings r: its bend is (r3 - r2 - r1 + r0) / 2.
        bends = np.diff(rate, 2)
        return float(bends @ bends) / len(bends) * float(dt_s.sum()) ** 2 / len(dt_s) / TURNS

    def _begin(self) -> None:
        """Begin a window at the next heading."""
        self._rates_rad_s.clear()
        self._times_s.clear()
        self._turns.clear()
        self._turn_rad = self._time_s = 0.0
        self._before_rad = None
