"""Another heading reference than the ceiling: a first look at it, before the filter relies on it.

A reference of unknown make may turn the other way than the gyro, be stamped late, or slip. A least
squares fit of its heading to the integrated gyro tells all of that; the filter then does the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, HeadingSample, ImuSample, Measurement, nanoseconds
from gyrocal_ros.ekf.run import History
from gyrocal_ros.errors import NotObservableError

OFFSETS_S = np.arange(-0.3, 0.3001, 0.01)
MIN_TURN_RAD = math.radians(45.0)
PLAUSIBLE_SCALE = (0.5, 2.0)
BLOCK_S = 5.0
WALKS_DEG = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Drifts of the reference, deg/sqrt(s), among which the likelihood chooses."""


@dataclass(frozen=True, slots=True)
class ReferenceFit:
    """How a heading reference goes with the gyro, by least squares over the whole recording."""

    scale_factor: float
    bias_rad_s: float
    time_offset_s: float
    """Stamp of the reference minus true time, positive when it is stamped late."""
    residual_rms_rad: float
    scale_std: float
    """Standard deviation of the scale factor by the scatter of the turns in blocks of 5 s; it holds
    whatever the reference's errors are, as long as they do not last longer than a block."""


def fit_reference(measurements: Iterable[Measurement], where: str) -> ReferenceFit:
    """Fit the reference heading by scale, bias, offset in time and offset in heading.

    Raises:
        NotObservableError: there is too little to fit, or the reference is unfit.
    """
    imu: list[tuple[int, float]] = []
    headings: list[tuple[int, float]] = []
    for sample in measurements:
        if isinstance(sample, ImuSample):
            imu.append((sample.t_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, HeadingSample):
            headings.append((sample.t_ns, sample.yaw_rad))
    if len(imu) < 2 or len(headings) < 10:
        raise NotObservableError(
            f'only {len(headings)} reference headings beside {len(imu)} IMU samples', where=where
        )
    start_ns = imu[0][0]
    imu_s, rate = _columns(imu, start_ns)
    heading_s, yaw = _columns(headings, start_ns)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu_s))])
    if np.ptp(np.unwrap(yaw)) < MIN_TURN_RAD and np.ptp(turned) < MIN_TURN_RAD:
        raise NotObservableError(
            'no turns, so the scale factor cannot be known', where=where, todo='record two turns each way'
        )
    yaw = np.unwrap(yaw)
    fits = [_fit(heading_s - offset_s, yaw, imu_s, turned, offset_s) for offset_s in OFFSETS_S]
    best = min(fits, key=lambda fit: fit.residual_rms_rad)
    if not PLAUSIBLE_SCALE[0] <= best.scale_factor <= PLAUSIBLE_SCALE[1]:
        raise NotObservableError(
            f'the reference turns {best.scale_factor:.2f} times as far as the gyro, so it is unfit as a '
            'heading reference: slipping wheels, or other units',
            where=where,
            todo='name a reference that does not slip',
        )
    return replace(best, scale_std=_scale_std(heading_s - best.time_offset_s, yaw, imu_s, turned))


def on_time(sample: HeadingSample, offset_s: float) -> HeadingSample:
    """The sample with its stamp put right."""
    return replace(sample, t_ns=sample.t_ns - nanoseconds(offset_s))


def log_likelihood(history: History) -> float:
    """Of the headings under the filter's own innovations and their covariances, but for a constant."""
    measured = history.dof > 0
    std = history.heading_innovation_std_rad[measured]
    return float(-0.5 * np.sum((history.heading_innovation_rad[measured] / std) ** 2) - np.sum(np.log(std)))


def _columns(samples: list[tuple[int, float]], start_ns: int) -> tuple[Array, Array]:
    return (
        np.array([(t_ns - start_ns) / NS_PER_S for t_ns, _ in samples]),
        np.array([value for _, value in samples]),
    )


def _fit(heading_s: Array, yaw: Array, imu_s: Array, turned: Array, offset_s: float) -> ReferenceFit:
    inside = (heading_s >= imu_s[0]) & (heading_s <= imu_s[-1])
    time_s, yaw = heading_s[inside], yaw[inside]
    columns = np.stack([np.interp(time_s, imu_s, turned), time_s, np.ones(len(time_s))], axis=1)
    solution = np.linalg.lstsq(columns, yaw, rcond=None)[0]
    residual = yaw - columns @ solution
    rms = float(np.sqrt(np.mean(residual**2)))
    return ReferenceFit(float(solution[0]), float(solution[1]), float(offset_s), rms, math.nan)


def _scale_std(heading_s: Array, yaw: Array, imu_s: Array, turned: Array) -> float:
    """Heteroscedasticity-consistent (HC3, MacKinnon and White 1985) over the turns in blocks."""
    edges = np.arange(max(heading_s[0], imu_s[0]), min(heading_s[-1], imu_s[-1]), BLOCK_S)
    if len(edges) < 5:
        return math.inf
    by_gyro, by_reference = (
        np.diff(np.interp(edges, imu_s, turned)),
        np.diff(np.interp(edges, heading_s, yaw)),
    )
    columns = np.stack([by_gyro, np.full(len(by_gyro), BLOCK_S)], axis=1)
    inverse = np.linalg.inv(columns.T @ columns)
    residual = by_reference - columns @ (inverse @ columns.T @ by_reference)
    leverage = np.einsum('ij,jk,ik->i', columns, inverse, columns)
    scores = columns * (residual / (1.0 - leverage))[:, None]
    return float(np.sqrt((inverse @ scores.T @ scores @ inverse)[0, 0]))
