"""The intervals between samples: what the IMU and the wheels measured in each of them."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import Any

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, ImuSample
from gyrocal_ros.kernels import compiled

PAUSE_NS = 1_000_000_000
"""Minimum length of a gap whose rates are not interpolated: its ends say nothing about the turn within."""


@compiled
def intervals(
    imu_ns: list[int],
    imu: list[ImuSample],
    start_ns: int,
    end_ns: int,
    running_s: float,
    lead_rad_s: float,
    wheels_ns: list[int],
    travelled_m: list[float],
    turned_rad: list[float],
) -> tuple[Any, ...]:
    """Return the columns of the N intervals between samples of a block.

    Args:
        imu_ns: times of the IMU samples.
        imu: the samples.
        start_ns: start of the block.
        end_ns: its end.
        running_s: time for which the gyro has been running at the start.
        lead_rad_s: rate about z by which interpolated rates lead; it is taken off.
        wheels_ns: times of the wheel encoders.
        travelled_m: way by the wheels until then.
        turned_rad: turn by the wheels until then.

    Returns:
        (N,) middles of the intervals in ns since the start, (N,) the same in s since the gyro has been
        running, (N,) their lengths in s, (N, 3) mean rates, (N,) yaw accelerations, (N, 3) mean specific
        forces, half the mean square of the differences of the specific force between successive samples, NaN
        with fewer than two, and (N,) ways, turns and speeds by the wheels, zero with fewer than two of their
        samples.
    """
    first, last = bisect_right(imu_ns, start_ns), bisect_left(imu_ns, end_ns)
    offsets_ns = np.array([t - start_ns for t in (start_ns, *imu_ns[first:last], end_ns)], float)
    inside = map(_readings, imu[first:last])
    values = np.array([_imu_at(imu_ns, imu, start_ns), *inside, _imu_at(imu_ns, imu, end_ns)])
    middle_ns = 0.5 * (offsets_ns[1:] + offsets_ns[:-1])
    means = 0.5 * (values[1:] + values[:-1])
    means[:, 2] -= lead_rad_s
    dt_s = (offsets_ns[1:] - offsets_ns[:-1]) / NS_PER_S
    acceleration_rad_s2 = (values[1:, 2] - values[:-1, 2]) / dt_s
    steps = values[2:-1, 3:] - values[1:-2, 3:]
    scatter = 0.5 * float(np.vdot(steps, steps)) / len(steps) if len(steps) else math.nan
    by_wheels = np.zeros((2, len(dt_s)))
    if len(wheels_ns) > 1:
        totals = (interpolate(start_ns, offsets_ns, wheels_ns, of) for of in (travelled_m, turned_rad))
        by_wheels = np.diff(np.array([*totals]))
    times = middle_ns, running_s + middle_ns / NS_PER_S, dt_s
    by_imu = means[:, :3], acceleration_rad_s2, means[:, 3:], scatter
    return *times, *by_imu, *by_wheels, by_wheels[0] / dt_s


def _imu_at(imu_ns: list[int], imu: list[ImuSample], t_ns: int) -> tuple[float, ...]:
    """Return rates and specific force at a time, interpolated linearly; without turning in a pause."""
    after = bisect_left(imu_ns, t_ns)
    later = _readings(imu[min(after, len(imu) - 1)])
    if after in (0, len(imu)) or imu_ns[after] == t_ns:
        return later
    earlier, interval_ns = _readings(imu[after - 1]), imu_ns[after] - imu_ns[after - 1]
    if interval_ns > PAUSE_NS:
        return 0.0, 0.0, 0.0, *earlier[3:]
    part = (t_ns - imu_ns[after - 1]) / interval_ns
    return tuple([a + part * (b - a) for a, b in zip(earlier, later, strict=True)])


@compiled
def usual_interval_ns(times_ns: list[int], first: int, usual_ns: float) -> float:
    """Return the usual interval between samples after some more of them.

    It decreases fast and increases slowly, so it is right even while most samples are lost.

    Args:
        times_ns: times of samples.
        first: index of the first new one, 1 or more.
        usual_ns: the usual interval before these.
    """
    for before_ns, t_ns in pairwise(times_ns[first - 1 :]):
        longer_ns = t_ns - before_ns - usual_ns
        usual_ns += longer_ns * (0.001 if longer_ns > 0.0 else 0.2)
    return usual_ns


def _readings(sample: ImuSample) -> tuple[float, ...]:
    return *sample.rate_rad_s, *sample.specific_force_m_s2


@compiled
def interpolate(start_ns: int, offsets_ns: Array, times_ns: list[int], values: list[float]) -> Array:
    """Interpolate linearly between samples; constant before the first and after the last.

    Args:
        start_ns: time from which the offsets count.
        offsets_ns: (n,) times, increasing.
        times_ns: times of the samples.
        values: the samples.
    """
    return np.interp(offsets_ns, np.array([t - start_ns for t in times_ns], float), values)
