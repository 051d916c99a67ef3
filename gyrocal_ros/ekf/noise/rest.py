"""Detection of standing still, and the noise of the yaw gyro meanwhile."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array, MotionBlock, seconds

WINDOW_S = 0.25
"""Length of the means that are compared: long beside vibration, short beside a rest."""
COMPARED_S = 2.0
"""Time over which means are compared: short beside the wander of a bias."""
PRIOR_WINDOWS = 4
"""Weight of the noise of the settings, in windows: with fewer a short rest would be quiet by chance."""
REPEATED = 0.5
"""Part of the readings that repeat the one before, from which their steps are too wide to show the noise."""


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


class RestNoise:
    """Noise of the yaw rate of a robot at rest, sway included, from the scatter of means of readings.

    Each mean is compared with that of the readings before it in the same rest. Changes from one mean to the
    next would share a mean, and a short rest would tell less of the noise.

    Args:
        usual_rad_s: density of the noise by the settings, rad/s/sqrt(Hz).
    """

    def __init__(self, usual_rad_s: float) -> None:
        self._usual_rad2_s = usual_rad_s**2
        self._sum_rad2_s, self._windows = PRIOR_WINDOWS * self._usual_rad2_s, PRIOR_WINDOWS
        self._turn_rad = self._time_s = 0.0
        self._turn_before_rad = self._time_before_s = 0.0
        self._repeated = self._readings = 0

    @property
    def density_rad_s(self) -> float:
        """Density of the noise, rad/s/sqrt(Hz); not below that of the settings where steps hide it."""
        density_rad2_s = self._sum_rad2_s / self._windows
        if self._repeated > REPEATED * self._readings:
            density_rad2_s = max(density_rad2_s, self._usual_rad2_s)
        return math.sqrt(density_rad2_s)

    def split(self, gyro: GyroConfig, sway_rad: float, duration_s: float) -> tuple[GyroConfig, Array]:
        """Return the settings with the noise at rest, and what exceeds it as standard deviations of the sway.

        Args:
            gyro: settings.
            sway_rad: standard deviation of the changes of roll and pitch within a second.
            duration_s: length of the rest.

        Returns:
            The settings, whose noise is not larger than that at rest, and (3,) standard deviations of the
            changes of the Euler angles.
        """
        noise_rad_s = min(math.radians(gyro.rate_noise_deg_s), self.density_rad_s)
        yaw_rad = math.sqrt((self.density_rad_s**2 - noise_rad_s**2) * duration_s)
        tilt_rad = sway_rad * math.sqrt(min(duration_s, 1.0))
        quieter = replace(gyro, rate_noise_deg_s=math.degrees(noise_rad_s))
        return quieter, np.array([tilt_rad, tilt_rad, yaw_rad])

    def add(self, block: MotionBlock, *, is_at_rest: bool) -> None:
        """Take one block."""
        if not is_at_rest:
            self._turn_rad = self._time_s = self._turn_before_rad = self._time_before_s = 0.0
            return
        rates = block.rate_rad_s[:, 2]
        self._repeated += int(np.count_nonzero(rates[1:] == rates[:-1]))
        self._readings += len(rates) - 1
        self._turn_rad += float(rates @ block.dt_s)
        self._time_s += block.duration_s
        if self._time_s >= WINDOW_S:
            self._compare()

    def _compare(self) -> None:
        """Compare the mean of the last readings with that of those before."""
        if self._time_before_s > 0.0:
            change_rad_s = self._turn_rad / self._time_s - self._turn_before_rad / self._time_before_s
            # The mean of a density q over T has the variance q^2 / T.
            self._sum_rad2_s += change_rad_s**2 / (1.0 / self._time_s + 1.0 / self._time_before_s)
            self._windows += 1
        if self._time_before_s > COMPARED_S:
            self._turn_before_rad = self._time_before_s = 0.0
        self._turn_before_rad += self._turn_rad
        self._time_before_s += self._time_s
        self._turn_rad = self._time_s = 0.0
