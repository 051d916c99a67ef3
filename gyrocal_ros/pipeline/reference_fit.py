"""Maximum-likelihood fit of a heading reference to the gyro, before the filter relies on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import GyroConfig
from gyrocal_ros.data import Array
from gyrocal_ros.ekf.equations.heading import GYRO_LAG
from gyrocal_ros.ekf.noise.reference_bank import NoiseFit, ReferenceBank, grid, likeliest_walk
from gyrocal_ros.ekf.noise.reference_noise import ReferenceNoise

MAX_HEADINGS = 5000
"""Number of headings that are used for the fit; of more, every second, third, ... is."""
WHITE_DEG = (1e-3, 10.0)
WALK_DEG = (1e-3, 5.0)
"""Ranges of the white noise (deg) and of the random walk (deg/sqrt(s))."""
TAIL_DOFS = (3.0, 5.0, 10.0, 30.0)
"""Degrees of freedom of the tails that are tried; 30 is close to a normal distribution."""
STAMPS_S = (0.0, 0.004, 0.016, 0.064)
"""Standard deviations of the stamps that are tried; a fine grid has three."""
COARSE_POINTS, FINE_POINTS = 9, 5
"""Points of a grid in white noise and in random walk; a fine one spans two steps of the one before."""
FINEST_SIZE, MAX_GRIDS = 0.125, 12
"""Half the size of the finest grid, in steps of the coarse one, and largest number of fine grids."""
TINY = 1e-9
"""Rounding error of a logarithm."""
WALK_POINTS = 40
"""Points at which the likelihood of the random walk is averaged."""
BIAS_WALKS = tuple(2.0**power for power in range(1, 8))
"""Random walks of the bias that are tried, relative to that of the settings."""
LESS_WALK = 1.5
"""Logarithm by which the random walk of the heading may be smaller beside them."""


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
    rest_s: Array
    """(n,) time since the heading before in which the robot was at rest."""
    rest_turn_rad: Array
    """(n,) turn by the nominal gyro in it."""
    rest_noise_rad_s: float
    """Density of the noise of the gyro at rest, rad/s/sqrt(Hz)."""

    def thinned(self, most: int) -> HeadingTrack:
        """Return the track with at most `most` headings."""
        step = -(-len(self.time_s) // most)
        gap_s, rest_s, rest_turn_rad = (
            np.diff(np.cumsum(column)[::step], prepend=0.0)
            for column in (self.gap_s, self.rest_s, self.rest_turn_rad)
        )
        return HeadingTrack(
            time_s=self.time_s[::step],
            yaw_rad=self.yaw_rad[::step],
            turned_rad=self.turned_rad[::step],
            rate_rad_s=self.rate_rad_s[::step],
            gap_s=gap_s,
            rest_s=rest_s,
            rest_turn_rad=rest_turn_rad,
            rest_noise_rad_s=self.rest_noise_rad_s,
        )


@dataclass(frozen=True, slots=True)
class ReferenceFit:
    """Fit of a heading reference to the gyro over the whole recording."""

    scale_factor: float
    bias_rad_s: float
    time_offset_s: float
    """Stamp of the reference minus true time, positive when it is stamped late. A lag of the gyro that is not
    certain looks the same, with the opposite sign."""
    time_offset_std_s: float
    residual_rms_rad: float
    """Rms difference from the least squares fit of scale factor, bias, heading and jumps."""
    white_rad: float
    """White noise of a heading."""
    walk_rad: float
    """Random walk of the reference and the gyro together, rad/sqrt(s)."""
    tail_dof: float
    """Degrees of freedom of the Student t distribution of its errors."""
    stamp_noise_s: float
    """Standard deviation of its stamps."""
    time_constant_s: float = 0.0
    """Time constant of the low pass by which it smooths its headings; the time offset includes its delay."""
    gyro_lag_s: float = 0.0
    """Time constant of a low pass in the gyro that is certain; the time offset does not include it."""
    gyro_lag_std_s: float = 0.0

    @property
    def certain_effects(self) -> frozenset[str]:
        """Names of the effects of the gyro that it shows."""
        return frozenset({GYRO_LAG} if self.gyro_lag_s else ())

    rest_noise_rad_s: float = 0.0
    """Density of the noise of the gyro at rest, rad/s/sqrt(Hz), sway included."""
    bias_walk_deg_s: float = 0.0
    """Random walk of the gyro's bias, deg/s/sqrt(s); at least that of the settings."""


def fit_noise(track: HeadingTrack, gyro: GyroConfig, near: NoiseFit | None = None) -> NoiseFit:
    """Find the likeliest noise on grids in its parameters, each finer than the last.

    A grid whose best lies at its edge is moved there before a finer one. The coarse grid has the heaviest
    tails only, with which the noise seems smaller than it is.

    Args:
        track: the headings.
        gyro: noise of the gyro.
        near: an earlier fit to the same headings, whose time offset they are corrected by. Its noise is not
            used: it may have taken a jump for a random walk.
    """
    track = track.thinned(MAX_HEADINGS)
    (log_white, white_step), (log_walk, walk_step) = (
        np.linspace(math.log(low), math.log(high), COARSE_POINTS, retstep=True)
        for low, high in (np.radians(WHITE_DEG), np.radians(WALK_DEG))
    )
    coarse = grid(log_white, log_walk, TAIL_DOFS[:1], STAMPS_S)
    best, size = _filtered(track, coarse, gyro, near).likeliest(), 1.0
    for _ in range(MAX_GRIDS):
        noise = best.noise
        steps = size * np.linspace(-1.0, 1.0, FINE_POINTS)
        white = math.log(noise.white_rad) + white_step * steps
        walk = math.log(noise.walk_rad) + walk_step * steps
        stamps_s = np.unique(float(noise.stamp_s) * 2.0 ** (size * np.array([-1.0, 0.0, 1.0]))).tolist()
        best = _filtered(track, grid(white, walk, TAIL_DOFS, stamps_s), gyro, near).likeliest()
        is_inside = _is_inside(best.noise, white, walk)
        if is_inside and size <= FINEST_SIZE:
            break
        size *= 0.5 if is_inside else 1.0
    return replace(best, noise=_mean_noise(track, best.noise, gyro, near))


def _is_inside(noise: ReferenceNoise, log_white: Array, log_walk: Array) -> bool:
    """Return True if a noise is not at the edge of a grid, or is so small that it does not count."""
    low_white, low_walk = math.radians(WHITE_DEG[0]), math.radians(WALK_DEG[0])
    pairs = ((float(noise.white_rad), low_white, log_white), (float(noise.walk_rad), low_walk, log_walk))
    return all(
        value <= low or log_axis[0] + TINY < math.log(value) < log_axis[-1] - TINY
        for value, low, log_axis in pairs
    )


def _mean_noise(
    track: HeadingTrack, likeliest: ReferenceNoise, gyro: GyroConfig, near: NoiseFit | None
) -> ReferenceNoise:
    """Return the likeliest noise with the mean random walk, as far as the track tells."""
    low_deg, high_deg = WALK_DEG
    walk = np.linspace(math.log(math.radians(low_deg)), math.log(math.radians(high_deg)), WALK_POINTS)
    white = np.log([float(likeliest.white_rad)])
    noise = grid(white, walk, (float(likeliest.tail_dof),), (float(likeliest.stamp_s),))
    return _filtered(track, noise, gyro, near).mean_noise()


def fit_bias_walk(track: HeadingTrack, fitted: NoiseFit, gyro: GyroConfig) -> float:
    """Return the random walk of the gyro's bias, deg/s/sqrt(s): of the settings, or a likelier larger one.

    Args:
        track: the headings.
        fitted: fit to them with the random walk of the settings.
        gyro: noise of the gyro.
    """
    track, noise = track.thinned(MAX_HEADINGS), fitted.noise
    # What a walk of the bias explains is no random walk of the heading.
    log_walk = math.log(noise.walk_rad) - np.linspace(0.0, LESS_WALK, FINE_POINTS)
    alternatives = grid(
        np.log([float(noise.white_rad)]), log_walk, (float(noise.tail_dof),), (float(noise.stamp_s),)
    )
    walks_deg_s = [gyro.bias_walk_deg_s * relative for relative in (1.0, *BIAS_WALKS)]
    likelihoods = [
        _filtered(track, alternatives, replace(gyro, bias_walk_deg_s=walk), fitted).likeliest().log_likelihood
        for walk in walks_deg_s
    ]
    return walks_deg_s[likeliest_walk(likelihoods)]


def log_likelihood_of(track: HeadingTrack, noise: ReferenceNoise, gyro: GyroConfig) -> float:
    """Return the log-likelihood of a track with a known noise."""
    known = ReferenceNoise(
        *(np.array([value]) for value in (noise.white_rad, noise.walk_rad, noise.tail_dof, noise.stamp_s))
    )
    return _filtered(track.thinned(MAX_HEADINGS), known, gyro).likeliest().log_likelihood


def _filtered(
    track: HeadingTrack, noise: ReferenceNoise, gyro: GyroConfig, near: NoiseFit | None = None
) -> ReferenceBank:
    """Filter a track with m alternatives of the noise, near an earlier fit."""
    bank = ReferenceBank(noise, gyro, near)
    columns = (
        np.diff(track.time_s, prepend=track.time_s[0]),
        np.diff(track.turned_rad, prepend=track.turned_rad[0]),
        track.gap_s,
        track.rate_rad_s,
        track.yaw_rad - track.turned_rad,
        track.rest_s,
        track.rest_turn_rad,
        track.rest_noise_rad_s * np.sqrt(track.rest_s),
    )
    bank.add(np.stack(columns, axis=1))
    return bank
