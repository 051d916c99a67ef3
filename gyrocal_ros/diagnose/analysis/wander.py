"""Heading by the gyro alone against the heading by the camera, with the error that noise explains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.heading_filter import Headings

MAX_MOMENTS = 400
"""Maximum number of moments at which the headings are compared; the covariance has its square."""
WINDOW_S = 10.0
"""Length of the windows over which the change of the heading error is computed."""


@dataclass(frozen=True, slots=True, eq=False)
class Wander:
    """Heading by the gyro less heading by the camera at m moments, the best constant bias removed."""

    time_s: Array
    error_rad: Array
    std_rad: Array
    """(m,) standard deviation by the noise of gyro and camera and the random walk of the bias."""
    gained_s: Array
    """(w,) centres of windows."""
    gained_rad: Array
    gained_std_rad: Array
    """(w,) change of the heading error in each window, and its standard deviation by noise."""


def wander(seen: Headings) -> Wander:
    """Compute the heading error of the gyro alone, and its standard deviation by noise.

    The noise is a random walk of the heading, one of the bias, and that of the camera. The bias that fits
    best is removed from the error, and from the covariance likewise.
    """
    known = np.flatnonzero(np.isfinite(seen.seen_rad) & np.isfinite(seen.std_rad))
    chosen = np.unique(np.linspace(0, len(known) - 1, MAX_MOMENTS).astype(int))
    rows = known[chosen]
    away = np.cumsum(seen.turn_rad)[known] - seen.seen_rad[known]
    time_s, error = seen.time_s[rows], _median_of_three(away)[chosen]
    covariance = _noise_covariance(seen, rows)
    basis = np.stack([np.ones(len(rows)), np.cumsum(seen.gyro_valid_s)[rows]], axis=1)
    without = np.eye(len(rows)) - basis @ np.linalg.pinv(basis)
    left, spread = without @ error, without @ covariance @ without.T
    edges = np.arange(time_s[0], time_s[-1], WINDOW_S)
    ends = np.unique(np.searchsorted(time_s, edges))
    jump = np.zeros((max(len(ends) - 1, 0), len(rows)))
    jump[np.arange(len(jump)), ends[1:]], jump[np.arange(len(jump)), ends[:-1]] = 1.0, -1.0
    return Wander(
        time_s=time_s,
        error_rad=left,
        std_rad=np.sqrt(np.diagonal(spread)),
        gained_s=0.5 * (time_s[ends[1:]] + time_s[ends[:-1]]),
        gained_rad=jump @ left,
        gained_std_rad=np.sqrt(np.einsum('wm,mn,wn->w', jump, spread, jump)),
    )


def _median_of_three(values: Array) -> Array:
    """Replace each value (n,) by the median of itself and its neighbours: single images may be far off."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    middle: Array = np.median([padded[:-2], values, padded[2:]], axis=0)
    return middle


def _noise_covariance(seen: Headings, rows: IntArray) -> Array:
    """Return the covariance (m, m) of the heading error by noise alone."""
    walk = seen.rate_noise_rad_s**2 + seen.map_walk_rad**2
    variance = np.cumsum(walk * seen.dt_s + seen.unobserved_turn_std_rad**2)[rows]
    time_s = seen.time_s[rows]
    first, last = np.minimum(time_s[:, None], time_s), np.maximum(time_s[:, None], time_s)
    by_bias = seen.bias_walk_rad_s**2 * first**2 * (3.0 * last - first) / 6.0
    return np.minimum(variance[:, None], variance) + by_bias + np.diag(seen.std_rad[rows] ** 2)
