"""Maximum-likelihood fit of a heading reference to the gyro, before the filter relies on it.

The difference between the heading by the reference and the heading by the nominal gyro is that of bias and
scale factor, of a time offset, and of noise. A Kalman filter with these as states gives the likelihood of the
noise parameters (Schweppe 1965). It runs for many of them side by side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.reference_noise import JUMP_LOG_PRIOR, JumpDetector, ReferenceNoise

MAX_HEADINGS = 5000
"""Number of headings that are used for the fit; of more, every second, third, ... is."""
WHITE_DEG = (1e-3, 10.0)
WALK_DEG = (1e-3, 5.0)
"""Ranges of the white noise (deg) and of the random walk (deg/sqrt(s))."""
TAIL_DOFS = (3.0, 5.0, 10.0, 30.0)
"""Degrees of freedom of the tails that are tried; 30 is close to a normal distribution."""
COARSE_POINTS, FINE_POINTS = 15, 5
"""Points of a grid in white noise and in random walk; a fine one spans two steps of the one before."""
REFINEMENTS = 3
PRIOR_STDS = (math.pi, math.radians(5.0), 0.2, 0.05)
"""Prior standard deviations: heading (rad), bias (rad/s), scale factor, time offset (s)."""
HEADING, BIAS, SCALE, OFFSET = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class HeadingTrack:
    """Headings by a reference beside the gyro, n headings."""

    time_s: Array
    """(n,) stamps less the time offset."""
    yaw_rad: Array
    """(n,) by the reference, unwrapped."""
    turned_rad: Array
    """(n,) by the nominal gyro since the start."""
    rate_rad_s: Array
    """(n,) nominal rate."""
    gap_s: Array
    """(n,) time since the heading before that no IMU sample covers."""

    def thinned(self, most: int) -> HeadingTrack:
        """Return the track with at most `most` headings."""
        step = -(-len(self.time_s) // most)
        gap_s = np.diff(np.cumsum(self.gap_s)[::step], prepend=0.0)
        return HeadingTrack(
            time_s=self.time_s[::step],
            yaw_rad=self.yaw_rad[::step],
            turned_rad=self.turned_rad[::step],
            rate_rad_s=self.rate_rad_s[::step],
            gap_s=gap_s,
        )


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFit:
    """The likeliest noise, and the states of the filter with it at the end of the track."""

    noise: ReferenceNoise
    log_likelihood: float
    mean: Array
    """(4,) heading, bias, scale factor less 1 and time offset."""
    covariance: Array
    """(4, 4)"""

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
        """Stamp of the reference minus true time, beyond the offset of the track."""
        return float(self.mean[OFFSET])

    @property
    def time_offset_std_s(self) -> float:
        """Its standard deviation."""
        return math.sqrt(self.covariance[OFFSET, OFFSET])


def fit_noise(track: HeadingTrack, gyro: GyroConfig) -> NoiseFit:
    """Find the likeliest noise on grids in white noise, random walk and tails, each finer than the last."""
    track = track.thinned(MAX_HEADINGS)
    white, walk = (
        np.linspace(math.log(low), math.log(high), COARSE_POINTS)
        for low, high in (np.radians(WHITE_DEG), np.radians(WALK_DEG))
    )
    best = _likeliest(track, _grid(white, walk, TAIL_DOFS[:1]), gyro)
    for _ in range(REFINEMENTS):
        white, walk = (
            np.linspace(math.log(value) - step, math.log(value) + step, FINE_POINTS)
            for value, step in (
                (best.noise.white_rad, white[1] - white[0]),
                (best.noise.walk_rad, walk[1] - walk[0]),
            )
        )
        best = _likeliest(track, _grid(white, walk, TAIL_DOFS), gyro)
    return best


def _grid(log_white: Array, log_walk: Array, dofs: Sequence[float]) -> ReferenceNoise:
    """Return all combinations of white noise, random walk and degrees of freedom."""
    white, walk, dof = (axis.ravel() for axis in np.meshgrid(np.exp(log_white), np.exp(log_walk), dofs))
    return ReferenceNoise(white, walk, dof)


def _likeliest(track: HeadingTrack, noise: ReferenceNoise, gyro: GyroConfig) -> NoiseFit:
    """Filter a track with m alternatives of the noise, and return the likeliest."""
    variances, walks = np.square(noise.white_rad), np.square(noise.walk_rad)
    count = len(variances)
    mean, P = np.zeros((count, 4)), np.tile(np.diag(np.square(PRIOR_STDS)), (count, 1, 1))
    mean[:, HEADING] = track.yaw_rad[0] - track.turned_rad[0]
    bias_walk = math.radians(gyro.bias_walk_deg_s) ** 2
    lost = np.square(math.radians(gyro.gap_rate_std_deg_s) * track.gap_s)
    likelihood, jumps = np.zeros(count), JumpDetector(count)
    columns = (
        np.diff(track.time_s, prepend=track.time_s[0]),
        np.diff(track.turned_rad, prepend=track.turned_rad[0]),
        track.rate_rad_s,
        lost,
        track.yaw_rad - track.turned_rad,
    )
    for dt_s, turn_rad, rate, lost_rad2, measured in zip(
        *(column.tolist() for column in columns), strict=True
    ):
        mean[:, HEADING] += dt_s * mean[:, BIAS] + turn_rad * mean[:, SCALE]
        P[:, HEADING] += dt_s * P[:, BIAS] + turn_rad * P[:, SCALE]
        P[:, :, HEADING] += dt_s * P[:, :, BIAS] + turn_rad * P[:, :, SCALE]
        P[:, HEADING, HEADING] += walks * dt_s + lost_rad2
        P[:, BIAS, BIAS] += bias_walk * dt_s

        numerator = P[:, HEADING] - rate * P[:, OFFSET]
        variance = numerator[:, HEADING] - rate * numerator[:, OFFSET] + variances
        residual = measured - mean[:, HEADING] + rate * mean[:, OFFSET]
        has_jumped = jumps.update(residual / np.sqrt(variance))
        if has_jumped.any():
            added = np.where(has_jumped, residual**2, 0.0)
            P[:, HEADING, HEADING] += added
            numerator[:, HEADING] += added
            variance = variance + added
            likelihood += JUMP_LOG_PRIOR * has_jumped
        distance = residual**2 / variance
        likelihood += noise.log_likelihood(variance, distance)

        gain = numerator * (noise.weight(distance) / variance)[:, None]
        mean += gain * residual[:, None]
        P -= gain[:, :, None] * numerator[:, None, :]
    best = int(np.argmax(likelihood))
    return NoiseFit(noise.alternative(best), float(likelihood[best]), mean[best], P[best])
