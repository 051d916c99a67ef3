"""Filters of a heading reference, one for each of many alternatives of its noise, side by side.

The difference between the heading by the reference and the heading by the nominal gyro is that of bias and
scale factor, of a time offset, and of noise. A Kalman filter with these as states gives the likelihood of the
noise parameters (Schweppe 1965).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.reference_noise import JUMP_LOG_PRIOR, JumpDetector, ReferenceNoise

PRIOR_STDS = (math.pi, math.radians(5.0), 0.2, 0.05)
"""Prior standard deviations: heading (rad), bias (rad/s), scale factor, time offset (s)."""
HEADING, BIAS, SCALE, OFFSET = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFit:
    """The likeliest noise, and the states of the filter with it."""

    noise: ReferenceNoise
    log_likelihood: float
    mean: Array
    """(4,) heading, bias, scale factor less 1 and time offset."""
    covariance: Array
    """(4, 4)"""
    jumps_s: tuple[float, ...] = ()
    """Times at which jumps of the reference were noticed, since its first heading."""

    @property
    def scale_factor(self) -> float:
        """True over nominal rate."""
        return 1.0 + float(self.mean[SCALE])

    @property
    def bias_rad_s(self) -> float:
        """Bias of the gyro."""
        return float(self.mean[BIAS])

    @property
    def time_offset_s(self) -> float:
        """Stamp of the reference minus true time, beyond the offset that is corrected already."""
        return float(self.mean[OFFSET])

    @property
    def time_offset_std_s(self) -> float:
        """Its standard deviation."""
        return math.sqrt(self.covariance[OFFSET, OFFSET])


class ReferenceBank:
    """Filters one heading after the other with m alternatives of the noise.

    Args:
        noise: the alternatives.
        gyro: noise of the gyro; its white noise is part of the random walk of the alternatives.
    """

    def __init__(self, noise: ReferenceNoise, gyro: GyroConfig) -> None:
        self._noise = noise
        self._variances, self._walks = np.square(noise.white_rad), np.square(noise.walk_rad)
        self._stamps = np.square(noise.stamp_s)
        self._bias_walk = math.radians(gyro.bias_walk_deg_s) ** 2
        self._gap_rate = math.radians(gyro.gap_rate_std_deg_s)
        count = len(self._variances)
        self._mean, self._P = np.zeros((count, 4)), np.tile(np.diag(np.square(PRIOR_STDS)), (count, 1, 1))
        self._log_likelihood, self._outlying = np.zeros(count), np.zeros(count)
        self._jumps = JumpDetector(count)
        self._elapsed_s, self._seen_jumps = 0.0, list[tuple[float, NDArray[np.bool_]]]()
        self.count = 0
        """Number of headings so far."""

    def add(
        self, dt_s: float, turn_rad: float, gap_s: float, rate_rad_s: float, difference_rad: float
    ) -> None:
        """Take one heading.

        Args:
            dt_s: time since the heading before.
            turn_rad: turn by the nominal gyro since then.
            gap_s: part of the time that no IMU sample covers.
            rate_rad_s: nominal rate.
            difference_rad: heading by the reference less the turn by the nominal gyro since the start.
        """
        mean, P = self._mean, self._P
        self._elapsed_s += dt_s
        if self.count == 0:
            mean[:, HEADING] = difference_rad
        mean[:, HEADING] += dt_s * mean[:, BIAS] + turn_rad * mean[:, SCALE]
        P[:, HEADING] += dt_s * P[:, BIAS] + turn_rad * P[:, SCALE]
        P[:, :, HEADING] += dt_s * P[:, :, BIAS] + turn_rad * P[:, :, SCALE]
        P[:, HEADING, HEADING] += self._walks * dt_s + (self._gap_rate * gap_s) ** 2
        P[:, BIAS, BIAS] += self._bias_walk * dt_s

        numerator = P[:, HEADING] - rate_rad_s * P[:, OFFSET]
        variance = numerator[:, HEADING] - rate_rad_s * numerator[:, OFFSET] + self._variances
        variance += self._stamps * rate_rad_s**2
        residual = difference_rad - mean[:, HEADING] + rate_rad_s * mean[:, OFFSET]
        may_have_jumped, has_jumped = self._jumps.update(residual / np.sqrt(variance), dt_s)
        if has_jumped.any():
            added = np.where(has_jumped, residual**2, 0.0)
            P[:, HEADING, HEADING] += added
            numerator[:, HEADING] += added
            variance = variance + added
            self._outlying[has_jumped] = JUMP_LOG_PRIOR  # what was an outlier was right in the new frame
            self._seen_jumps.append((self._elapsed_s, has_jumped))
        distance = residual**2 / variance
        # Outliers count when it is known that they were no jump.
        self._outlying += self._noise.log_likelihood(variance, distance)
        is_known = ~self._jumps.are_apart
        self._log_likelihood[is_known] += self._outlying[is_known]
        self._outlying[is_known] = 0.0

        weight = np.where(may_have_jumped, 0.0, self._noise.weight(distance))
        gain = numerator * (weight / variance)[:, None]
        mean += gain * residual[:, None]
        P -= gain[:, :, None] * numerator[:, None, :]
        self.count += 1

    def correct_offset(self, offset_s: float) -> None:
        """Note that the stamps are corrected by a further time offset from now on."""
        self._mean[:, OFFSET] -= offset_s

    def mean_noise(self) -> ReferenceNoise:
        """Return the noise with the mean variances over all alternatives, weighted by their likelihood.

        A short recording often does not tell a small random walk from none. The likeliest one would then make
        the filter overconfident; the mean, with all random walks up to the largest equally probable before,
        does not. The walks of the alternatives have to be evenly spaced in their logarithm.
        """
        walk = np.asarray(self._noise.walk_rad)
        log_weight = self._log_likelihood + np.log(walk)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        white_rad, walk_rad, stamp_s = (
            math.sqrt(float(weight @ variances)) for variances in (self._variances, self._walks, self._stamps)
        )
        return ReferenceNoise(white_rad, walk_rad, self.likeliest().noise.tail_dof, stamp_s)

    def likeliest(self) -> NoiseFit:
        """Return the likeliest alternative so far."""
        best = int(np.argmax(self._log_likelihood))
        likelihood = float(self._log_likelihood[best])
        jumps_s = tuple(time_s for time_s, has_jumped in self._seen_jumps if has_jumped[best])
        return NoiseFit(
            self._noise.alternative(best), likelihood, self._mean[best].copy(), self._P[best].copy(), jumps_s
        )


def grid(
    log_white: Array, log_walk: Array, dofs: Sequence[float], stamps_s: Sequence[float]
) -> ReferenceNoise:
    """Return all combinations of white noise, random walk, degrees of freedom and noise of the stamps."""
    axes = np.meshgrid(np.exp(log_white), np.exp(log_walk), dofs, stamps_s)
    return ReferenceNoise(*(axis.ravel() for axis in axes))
