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
from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.noise.reference_noise import JUMP_LOG_PRIOR, OUTLIER_SIGMA, JumpDetector, ReferenceNoise
from gyrocal_ros.kernels import compiled

PRIOR_STDS = (math.pi, math.radians(5.0), 0.2, 0.05)
"""Prior standard deviations: heading (rad), bias (rad/s), scale factor, time offset (s)."""
HEADING, BIAS, SCALE, OFFSET = range(4)
BIAS_WALK_GAIN = 1.0
"""Log-likelihood that a bias has to gain that walks more than the settings say, by the criterion of Akaike
(1974)."""
KNOWN_SIGMA = 10.0
"""Prior standard deviations of what an earlier fit to the same headings found, in its own: wide enough that
they hardly count twice."""


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
    """Filters headings with m alternatives of the noise.

    Args:
        noise: the alternatives.
        gyro: noise of the gyro; its white noise is part of the random walk of the alternatives.
        near: an earlier fit to the same headings. Without one a jump just before the first turn passes for an
            error of scale factor or time offset, and what follows for a random walk.
    """

    def __init__(self, noise: ReferenceNoise, gyro: GyroConfig, near: NoiseFit | None = None) -> None:
        columns = (noise.white_rad, noise.walk_rad, noise.tail_dof, noise.stamp_s)
        self._noise = ReferenceNoise(*(np.array(column, float) for column in np.broadcast_arrays(*columns)))
        self._bias_walk = math.radians(gyro.bias_walk_deg_s) ** 2
        self._gap_rate = math.radians(gyro.gap_rate_std_deg_s)
        count = len(np.atleast_1d(self._noise.white_rad))
        mean, stds = _prior(near)
        self._mean, self._P = np.tile(mean, (count, 1)), np.tile(np.diag(np.square(stds)), (count, 1, 1))
        self._log_likelihood, self._outlying = np.zeros(count), np.zeros(count)
        self._jumps = JumpDetector(count)
        self._elapsed_s, self._seen_jumps = 0.0, list[tuple[float, NDArray[np.bool_]]]()
        self.count = 0
        """Number of headings so far."""

    def add(self, headings: Array) -> None:
        """Take headings (n, 8).

        Their columns are the time since the heading before, the turn by the nominal gyro since then, the part
        of the time that no IMU sample covers, the nominal rate, the heading by the reference less the turn by
        the nominal gyro since the start, the part of the time at rest, the turn by the nominal gyro in it,
        and the standard deviation of that by the noise of the gyro.
        """
        if self.count == 0:
            self._mean[:, HEADING] = headings[0, 4]
        jumps = self._jumps
        *state, has_jumped = filter_headings(
            self._mean,
            self._P,
            self._log_likelihood,
            self._outlying,
            jumps.outliers,
            jumps.side,
            jumps.since_s,
            self._noise,
            self._bias_walk,
            self._gap_rate,
            headings,
        )
        self._mean, self._P, self._log_likelihood, self._outlying = state[:4]
        jumps.outliers, jumps.side, jumps.since_s = state[4:]
        elapsed_s = self._elapsed_s + np.cumsum(headings[:, 0])
        for row in np.flatnonzero(has_jumped.any(axis=1)):
            self._seen_jumps.append((float(elapsed_s[row]), has_jumped[row]))
        self._elapsed_s = float(elapsed_s[-1])
        self.count += len(headings)

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
            math.sqrt(float(weight @ np.square(stds)))
            for stds in (self._noise.white_rad, self._noise.walk_rad, self._noise.stamp_s)
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


def _prior(near: NoiseFit | None) -> tuple[Array, Array]:
    """Return means and standard deviations (4,) of the states before the first heading.

    Scale factor and time offset, which do not change, are near those of an earlier fit; its time offset has
    been corrected.
    """
    mean, stds = np.zeros(4), np.array(PRIOR_STDS)
    if near is not None:
        mean[SCALE] = near.mean[SCALE]
        known = KNOWN_SIGMA * np.sqrt(np.diag(near.covariance))
        stds[[SCALE, OFFSET]] = np.minimum(stds, known)[[SCALE, OFFSET]]
    return mean, stds


@compiled
def filter_headings(
    mean: Array,
    covariance: Array,
    log_likelihood: Array,
    outlying: Array,
    outliers: IntArray,
    side: Array,
    since_s: Array,
    noise: ReferenceNoise,
    bias_walk: float,
    gap_rate_rad_s: float,
    headings: Array,
) -> tuple[np.ndarray, ...]:
    """Filter n headings with m alternatives of the noise.

    Args:
        mean: (m, 4)
        covariance: (m, 4, 4)
        log_likelihood: (m,) of all headings before, outliers aside that may be jumps.
        outlying: (m,) of these.
        outliers: (m,) see `JumpDetector`.
        side: (m,)
        since_s: (m,)
        noise: the alternatives, each field (m,).
        bias_walk: variance of the bias per second.
        gap_rate_rad_s: standard deviation of the rate while no IMU sample comes.
        headings: (n, 8) see `ReferenceBank.add`.

    Returns:
        The first seven after the headings, and (n, m) where the reference has jumped.
    """
    mean, P, log_likelihood, outlying = (
        column.copy() for column in (mean, covariance, log_likelihood, outlying)
    )
    jumps = JumpDetector(len(mean))
    jumps.outliers, jumps.side, jumps.since_s = outliers, side, since_s
    jumped = np.zeros((len(headings), len(mean)), bool)
    for row, columns in enumerate(headings.tolist()):
        dt_s, turn_rad, gap_s, rate_rad_s, difference_rad, rest_s, rest_turn_rad, rest_std_rad = columns
        still = _rest_update(mean, P, log_likelihood, rest_s, rest_turn_rad, rest_std_rad)
        moving_s, moving_rad = dt_s - still * rest_s, turn_rad - still * rest_turn_rad
        mean[:, HEADING] += moving_s * mean[:, BIAS] + moving_rad * mean[:, SCALE] - still * rest_turn_rad
        P[:, HEADING] += moving_s[:, None] * P[:, BIAS] + moving_rad[:, None] * P[:, SCALE]
        P[:, :, HEADING] += moving_s[:, None] * P[:, :, BIAS] + moving_rad[:, None] * P[:, :, SCALE]
        P[:, HEADING, HEADING] += np.square(noise.walk_rad) * dt_s + (gap_rate_rad_s * gap_s) ** 2
        P[:, BIAS, BIAS] += bias_walk * dt_s

        numerator = P[:, HEADING] - rate_rad_s * P[:, OFFSET]
        noise_variance = np.square(noise.white_rad) + np.square(noise.stamp_s) * rate_rad_s**2
        variance = numerator[:, HEADING] - rate_rad_s * numerator[:, OFFSET] + noise_variance
        residual = difference_rad - mean[:, HEADING] + rate_rad_s * mean[:, OFFSET]
        may_have_jumped, has_jumped = jumps.update(residual / np.sqrt(variance), dt_s)
        if has_jumped.any():
            jumped[row] = has_jumped
            added = np.where(has_jumped, residual**2, 0.0)
            P[:, HEADING, HEADING] += added
            numerator[:, HEADING] += added
            variance = variance + added
            outlying[has_jumped] = JUMP_LOG_PRIOR  # what was an outlier was right in the new frame
        distance = residual**2 / variance
        # Outliers count when it is known that they were no jump.
        outlying += noise.log_likelihood(variance, distance)
        is_known = ~jumps.are_apart
        log_likelihood[is_known] += outlying[is_known]
        outlying[is_known] = 0.0

        gain = numerator * (~may_have_jumped / variance)[:, None]
        mean += gain * (noise.pull(distance, noise_variance / variance) * residual)[:, None]
        weight = np.asarray(noise.weight(distance))
        P -= (gain * weight[:, None])[:, :, None] * numerator[:, None, :]
    return mean, P, log_likelihood, outlying, jumps.outliers, jumps.side, jumps.since_s, jumped


def _rest_update(
    mean: Array,
    P: Array,
    log_likelihood: Array,
    rest_s: float,
    turn_rad: float,
    std_rad: float,
) -> Array:
    """Correct m filters in place by the turn of the gyro at rest, which shows its bias.

    Returns:
        (m,) 1 where the heading did not change, 0 without a rest and where the gyro contradicts it.
    """
    if rest_s == 0.0:
        return np.zeros(len(mean))
    numerator = rest_s * P[:, BIAS] + turn_rad * P[:, SCALE]
    variance = rest_s * numerator[:, BIAS] + turn_rad * numerator[:, SCALE] + std_rad**2
    residual = -(turn_rad + rest_s * mean[:, BIAS] + turn_rad * mean[:, SCALE])
    distance = residual**2 / variance
    still = np.where(distance <= OUTLIER_SIGMA**2, 1.0, 0.0)
    log_likelihood -= 0.5 * (np.log(variance) + np.minimum(distance, OUTLIER_SIGMA**2))
    gain = numerator * (still / variance)[:, None]
    mean += gain * residual[:, None]
    P -= gain[:, :, None] * numerator[:, None, :]
    return still


def likeliest_walk(log_likelihoods: Sequence[float]) -> int:
    """Return the place of the likeliest random walk of the bias: the first if no other gains enough."""
    best = int(np.argmax(log_likelihoods))
    return best if log_likelihoods[best] > log_likelihoods[0] + BIAS_WALK_GAIN else 0


def grid(
    log_white: Array, log_walk: Array, dofs: Sequence[float], stamps_s: Sequence[float]
) -> ReferenceNoise:
    """Return all combinations of white noise, random walk, degrees of freedom and noise of the stamps."""
    axes = np.meshgrid(np.exp(log_white), np.exp(log_walk), dofs, stamps_s)
    return ReferenceNoise(*(axis.ravel() for axis in axes))
