"""Noise and time offset of a heading reference, learned while the robot drives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import MotionBlock
from gyrocal_ros.ekf.noise.reference_bank import ReferenceBank, grid, likeliest_walk
from gyrocal_ros.ekf.noise.reference_noise import ReferenceNoise

WHITE_DEG, WALK_DEG, TAIL_DOF = (0.003, 5.0), (0.005, 3.0), 5.0
"""Ranges of the white noise (deg) and the random walk (deg/sqrt(s)), and degrees of freedom of the tails."""
POINTS = 14
"""Points of the grid in each: neighbours differ by a factor of 1.8 and 1.6."""
STAMPS_S = (0.0, 0.01, 0.03)
"""Standard deviations of the stamps that are tried."""
BIAS_WALKS = (6.0, 36.0)
"""Random walks of the bias that are tried beside that of the settings, relative to it."""
MIN_HEADINGS, MIN_S = 50, 20.0
"""Fewest headings, and shortest time, before the reference is used."""
MAX_OFFSET_STD_S = 0.01
"""Largest standard deviation of the time offset with which the reference is used; it needs a turn."""
LEARN_INTERVAL_S = 5.0
"""Interval between changes of the noise and of the time offset in use."""


class ReferenceLearner:
    """Compares the headings of a reference with the turns of the nominal gyro, step by step.

    Args:
        gyro: noise of the gyro.
    """

    def __init__(self, gyro: GyroConfig) -> None:
        white, walk = (
            np.linspace(math.log(low), math.log(high), POINTS)
            for low, high in (np.radians(WHITE_DEG), np.radians(WALK_DEG))
        )
        alternatives = grid(white, walk, (TAIL_DOF,), STAMPS_S)
        self._bias_walks_deg_s = [gyro.bias_walk_deg_s * relative for relative in (1.0, *BIAS_WALKS)]
        self._banks = [
            ReferenceBank(alternatives, replace(gyro, bias_walk_deg_s=walk_deg_s))
            for walk_deg_s in self._bias_walks_deg_s
        ]
        self._turned_rad = self._difference_rad = 0.0
        self._since = np.zeros(6)
        self._time_s = self._learned_s = 0.0
        self.time_offset_s = 0.0
        """Stamp minus true time, as far as it is known."""
        self.time_offset_std_s = math.inf
        self.noise: ReferenceNoise | None = None
        """The likeliest noise; None until the reference can be used."""
        self.bias_walk_deg_s = gyro.bias_walk_deg_s
        """Random walk of the bias of the gyro, deg/s/sqrt(s): of the settings, or a likelier larger one."""

    def move(self, block: MotionBlock, rest_noise_rad_s: float | None = None) -> None:
        """Follow one block of the gyro.

        Args:
            block: samples of the gyro.
            rest_noise_rad_s: density of the noise of the gyro where the robot is at rest in the block.
        """
        duration_s, turn_rad = block.duration_s, float(block.rate_rad_s[:, 2] @ block.dt_s)
        self._turned_rad += turn_rad
        self._since[:3] += duration_s, turn_rad, block.gap_s
        if rest_noise_rad_s is not None:
            self._since[3:] += duration_s, turn_rad, rest_noise_rad_s**2 * duration_s
        self._time_s += duration_s

    def add(self, yaw_rad: float, rate_rad_s: float) -> None:
        """Take the heading at the end of the last block.

        Args:
            yaw_rad: by the reference.
            rate_rad_s: nominal rate.
        """
        difference = yaw_rad - self._turned_rad
        count = self._banks[0].count
        turns = round((difference - self._difference_rad) / (2.0 * math.pi)) if count else 0
        self._difference_rad = difference - 2.0 * math.pi * turns
        moved, rested = self._since[:3], self._since[3:]
        heading = np.array([[*moved, rate_rad_s, self._difference_rad, *rested[:2], math.sqrt(rested[2])]])
        for bank in self._banks:
            bank.add(heading)
        self._since[:] = 0.0
        if count + 1 >= MIN_HEADINGS and self._time_s >= max(MIN_S, self._learned_s + LEARN_INTERVAL_S):
            self._learn()

    def _learn(self) -> None:
        self._learned_s = self._time_s
        fits = [bank.likeliest() for bank in self._banks]
        best = likeliest_walk([fit.log_likelihood for fit in fits])
        fit = fits[best]
        if fit.time_offset_std_s > MAX_OFFSET_STD_S:
            return
        self.time_offset_s += fit.time_offset_s
        self.time_offset_std_s = fit.time_offset_std_s
        for bank in self._banks:
            bank.correct_offset(fit.time_offset_s)
        # A large offset is only linear in the rate: it is known when its correction has been corrected.
        if self.noise is not None or abs(fit.time_offset_s) < MAX_OFFSET_STD_S:
            self.noise = self._banks[best].mean_noise()
            self.bias_walk_deg_s = self._bias_walks_deg_s[best]
