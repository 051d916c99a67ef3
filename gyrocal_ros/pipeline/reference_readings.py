"""Gyro and heading reference of a recording as arrays, and the headings beside the gyro at a time offset."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.config.sections import Config
from gyrocal_ros.data import NS_PER_S, Array, ClockStep, HeadingSample, ImuSample, Measurement
from gyrocal_ros.ekf.intervals import PAUSE_NS
from gyrocal_ros.ekf.motion import GAP_NS
from gyrocal_ros.errors import NotObservableError
from gyrocal_ros.pipeline.reference_fit import MAX_HEADINGS, HeadingTrack
from gyrocal_ros.pipeline.reference_smoothing import low_passed, turned_rad
from gyrocal_ros.pipeline.rests import RestFinder

MIN_HEADINGS = 10
MIN_TURN_RAD = math.radians(45.0)
"""Smallest sum of turns, to both sides, that can be fitted."""
MIN_RATE_RAD_S = math.radians(2.0)
"""Rate beside the bias from which the robot turns."""
SWING_S = 0.2
"""Time over which rates are averaged for it; swings to and fro are slower."""
MARGIN_S = 1.0
"""Time at both ends that is left out where time offsets are compared: each then has the same headings."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Gyro and reference over a recording."""

    imu_s: Array
    rate_rad_s: Array
    turned_rad: Array
    """(i,) integral of the rate."""
    rested_s: Array
    """(i,) time at rest up to each."""
    rest_noise_rad_s: float
    """Density of the noise of the gyro at rest, rad/s/sqrt(Hz)."""
    heading_s: Array
    yaw_rad: Array
    """(n,) as measured, not unwrapped."""


def read_headings(measurements: Iterable[Measurement], where: str, config: Config) -> Readings:
    """Collect gyro and reference.

    Raises:
        NotObservableError: there is too little to fit.
    """
    imu: list[tuple[int, float]] = []
    headings: list[tuple[int, float]] = []
    finder, rests_ns = RestFinder(config), [0]
    stepped_ns = 0
    for sample in measurements:
        rest_ns = finder.add(sample)
        if rest_ns is not None:
            rests_ns += [at_ns - stepped_ns for at_ns in rest_ns]
        if isinstance(sample, ClockStep):
            stepped_ns += sample.step_ns - 2 * PAUSE_NS  # how the robot moved meanwhile is not known
        elif isinstance(sample, ImuSample):
            imu.append((sample.t_ns - stepped_ns, sample.rate_rad_s[2]))
        elif isinstance(sample, HeadingSample):
            headings.append((sample.t_ns - stepped_ns, sample.yaw_rad))
    if len(imu) < 2 or len(headings) < MIN_HEADINGS:
        raise NotObservableError(
            f'only {len(headings)} reference headings beside {len(imu)} IMU samples',
            where=where,
            todo='give a reference that is measured at least once a second',
        )
    start_ns = imu[0][0]
    imu_s, rate = _columns(imu, start_ns)
    heading_s, yaw = _columns(headings, start_ns)
    turned = turned_rad(imu_s, rate)
    if _turned_to_and_fro_rad(imu_s, turned) < MIN_TURN_RAD:
        raise NotObservableError(
            'no turns, so the scale factor cannot be known', where=where, todo='record two turns each way'
        )
    edges_s = (np.array(rests_ns) - start_ns) / NS_PER_S
    rested_s = np.cumsum(np.diff(edges_s, prepend=edges_s[0]) * (np.arange(len(edges_s)) % 2 == 0))
    return Readings(
        imu_s, rate, turned, np.interp(imu_s, edges_s, rested_s), finder.noise_rad_s, heading_s, yaw
    )


def without_repetitions(readings: Readings) -> Readings:
    """Return the readings without headings that repeat the one before exactly, which are no measurements."""
    is_new = np.diff(readings.yaw_rad, prepend=math.nan) != 0.0
    return replace(readings, heading_s=readings.heading_s[is_new], yaw_rad=readings.yaw_rad[is_new])


def _turned_to_and_fro_rad(imu_s: Array, turned_rad: Array) -> float:
    """Return the sum of the turns to both sides, beside the bias and the noise of the gyro."""
    edges_s = np.arange(imu_s[0], imu_s[-1], SWING_S)
    turns = np.diff(np.interp(edges_s, imu_s, turned_rad))
    turns = np.abs(turns - np.median(turns)) if len(turns) else turns
    return float(turns[turns > MIN_RATE_RAD_S * SWING_S].sum())


def track_at(readings: Readings, offset_s: float, gyro: tuple[float, float] = (1.0, 0.0)) -> HeadingTrack:
    """Return the headings beside the gyro, at a time offset.

    Headings are unwrapped by the gyro, so that a gap in which the robot turns is no ambiguity.

    Args:
        readings: gyro and reference.
        offset_s: stamp minus true time of the reference.
        gyro: scale factor and bias (rad/s) as far as they are known.
    """
    imu_s, time_s = readings.imu_s, readings.heading_s - offset_s
    inside = (time_s >= imu_s[0]) & (time_s <= imu_s[-1])
    time_s = time_s[inside]
    around = float(np.median(np.diff(imu_s)))
    turned, before, after = (
        _interpolated(time_s + shift_s, imu_s, readings.turned_rad) for shift_s in (0.0, -around, around)
    )
    expected = gyro[0] * turned + gyro[1] * time_s
    at_rest = np.diff(readings.rested_s) / np.diff(imu_s)
    rest_turned = np.concatenate([[0.0], np.cumsum(at_rest * np.diff(readings.turned_rad))])
    return HeadingTrack(
        time_s=time_s,
        yaw_rad=expected + np.unwrap(readings.yaw_rad[inside] - expected),
        turned_rad=turned,
        rate_rad_s=(after - before) / (2.0 * around),
        gap_s=np.diff(np.interp(time_s, *_gap_time(imu_s)), prepend=0.0),
        rest_s=_increments(np.interp(time_s, imu_s, readings.rested_s)),
        rest_turn_rad=_increments(np.interp(time_s, imu_s, rest_turned)),
        rest_noise_rad_s=readings.rest_noise_rad_s,
    )


def smoothed(readings: Readings, time_constant_s: float) -> Readings:
    """Return the readings with the turn by the gyro behind a low pass."""
    return _with_turn(readings, low_passed(readings.imu_s, readings.turned_rad, time_constant_s))


def sharpened(readings: Readings, lag_s: float) -> Readings:
    """Return the readings with the turn by the gyro before a low pass in it, of that time constant."""
    return _with_turn(readings, readings.turned_rad + lag_s * readings.rate_rad_s)


def _with_turn(readings: Readings, turn_rad: Array) -> Readings:
    """Return the readings with another turn by the gyro.

    Rests are left out: the noise in them is not that of the gyro any more.
    """
    return replace(readings, turned_rad=turn_rad, rested_s=np.zeros(len(turn_rad)))


def comparable(readings: Readings) -> Readings:
    """Return the readings with the same headings for all time offsets, at most `MAX_HEADINGS`."""
    heading_s, ends_s = readings.heading_s, readings.imu_s[[0, -1]]
    inner = (heading_s > ends_s[0] + MARGIN_S) & (heading_s < ends_s[1] - MARGIN_S)
    step = max(-(-int(inner.sum()) // MAX_HEADINGS), 1)
    return replace(readings, heading_s=heading_s[inner][::step], yaw_rad=readings.yaw_rad[inner][::step])


def _interpolated(at_s: Array, time_s: Array, turned_rad: Array) -> Array:
    """Interpolate turns (i,) at times (i,) by cubic Hermite splines, at times (n,); constant beyond the ends.

    A line between two samples cuts the corner where the rate changes, which would look like a low pass. In a
    gap it is all that is known.
    """
    if len(time_s) < 3:
        return np.interp(at_s, time_s, turned_rad)
    rate = np.gradient(turned_rad, time_s)
    after = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    interval_s = time_s[after] - time_s[after - 1]
    part = np.clip((at_s - time_s[after - 1]) / interval_s, 0.0, 1.0)
    step_rad = turned_rad[after] - turned_rad[after - 1]
    start, end = rate[after - 1] * interval_s - step_rad, step_rad - rate[after] * interval_s
    bend = part * (1.0 - part) * ((1.0 - part) * start + part * end)
    return turned_rad[after - 1] + part * step_rad + np.where(interval_s > GAP_NS / NS_PER_S, 0.0, bend)


def _increments(values: Array) -> Array:
    """Return the increments (n,) of values; that of the first is zero."""
    return np.diff(values, prepend=values[0])


def _gap_time(imu_s: Array) -> tuple[Array, Array]:
    """Return times and the time in gaps of the IMU up to each."""
    interval_s = np.diff(imu_s)
    in_gaps = np.where(interval_s > GAP_NS / NS_PER_S, interval_s, 0.0)
    return imu_s, np.concatenate([[0.0], np.cumsum(in_gaps)])


def _columns(samples: list[tuple[int, float]], start_ns: int) -> tuple[Array, Array]:
    return (
        np.array([(t_ns - start_ns) / NS_PER_S for t_ns, _ in samples]),
        np.array([value for _, value in samples]),
    )
