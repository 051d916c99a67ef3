"""Buffer of samples of the IMU and of slower sensors, which are cut into blocks for the filter."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import Any

import numpy as np

from gyrocal_ros.data import (
    NS_PER_S,
    Array,
    CovariateSample,
    ImuSample,
    MotionBlock,
    TemperatureSample,
    WheelSample,
    constant,
    seconds,
)
from gyrocal_ros.kernels import compiled
from gyrocal_ros.model.faulty_readings import FaultyGyro, FaultyWheels
from gyrocal_ros.model.recording import SPEED_SIGNAL

GAP_NS = 100_000_000
"""Maximum interval between IMU samples; a longer one is a gap."""
PAUSE_NS = 1_000_000_000
"""Minimum length of a gap whose rates are not interpolated: its ends say nothing about the turn within."""
DROPOUT_INTERVALS, MIN_DROPOUT_NS = 4.0, 15_000_000
"""Minimum length of a dropout (some samples lost), in usual intervals and in ns; both have to be exceeded."""
DROPOUT_S = 1.0
"""Scale of the weight of a dropout: one of length t counts as a gap of t * t / DROPOUT_S, since the rates at
its ends are known."""
VIBRATION_S = 0.05
"""Time constant of the estimate of the vibration. What the vibration does to the heading adds up, so a longer
one makes nothing more certain; and where the robot starts or stops, a late estimate looks like an effect of
the acceleration."""
LEAD_PART = 0.1
"""Turn by which interpolated rates lead, in squared sample intervals times the yaw acceleration. By the rule
of Euler and Maclaurin it is 1/12 where a reading is the rate at its stamp, and 1/8 where it is the mean about
that. The lead ends as the turn does, but the filter would learn a scale factor that is too large by 5e-5, for
it compares turns between images."""
WHEEL_TIMEOUT_NS = 300_000_000
"""Maximum lag of the encoders behind the IMU; beyond it, prediction continues without them."""


class _Signal:
    """A slow signal: the samples that the next block may require."""

    def __init__(self) -> None:
        self.t_ns: list[int] = []
        self.values: list[float] = []

    def append(self, t_ns: int, value: float) -> None:
        if not self.t_ns or t_ns > self.t_ns[-1]:
            self.t_ns.append(t_ns)
            self.values.append(value)

    def at(self, t_ns: int, offsets_ns: Array) -> Array:
        """Return the values (n,) at times after `t_ns`."""
        return interpolate(t_ns, offsets_ns, self.t_ns, self.values)

    def forget_before(self, t_ns: int) -> None:
        first = max(bisect_right(self.t_ns, t_ns) - 1, 0)
        del self.t_ns[:first], self.values[:first]


class MotionBuffer:
    """Buffers the samples since the last block. Blocks must be cut one after the other.

    Args:
        running_s: time for which the gyro has been running at the first sample.
    """

    def __init__(self, running_s: float = 0.0) -> None:
        self.start_ns: int | None = None
        self.faulty_gyro, self._faulty_wheels = FaultyGyro(), FaultyWheels()
        self._running_s = running_s
        self._imu_ns: list[int] = []
        self._usual_interval_ns = float(GAP_NS)
        self._imu: list[tuple[float, ...]] = []
        self._vibration_m2_s4: float | None = None
        self._lead_rad = 0.0
        self._travelled = _Signal()
        self._turned = _Signal()
        self._speeds: list[tuple[float, float]] = []
        self._temperature = _Signal()
        self._covariates: dict[str, _Signal] = {}

    def add(self, sample: ImuSample | WheelSample | TemperatureSample | CovariateSample) -> None:
        """Add one sample; a sample that is not newer than the last of its kind is ignored."""
        if isinstance(sample, ImuSample):
            for sound in self.faulty_gyro.sound(sample):
                self._add_imu(sound)
        elif isinstance(sample, WheelSample):
            for moved in self._faulty_wheels.sound(sample):
                self._add_wheels(moved)
        elif isinstance(sample, TemperatureSample):
            self._temperature.append(sample.t_ns, sample.temperature_c)
        else:
            self._covariates.setdefault(sample.name, _Signal()).append(sample.t_ns, sample.value)

    def _add_imu(self, sample: ImuSample) -> None:
        if self.start_ns is None:
            self.start_ns = sample.t_ns
        if self._imu_ns:
            # Fast decrease and slow increase: right even while most samples are lost.
            longer_ns = sample.t_ns - self._imu_ns[-1] - self._usual_interval_ns
            self._usual_interval_ns += longer_ns * (0.001 if longer_ns > 0.0 else 0.2)
        self._imu_ns.append(sample.t_ns)
        self._imu.append((*sample.rate_rad_s, *sample.specific_force_m_s2))

    def _add_wheels(self, sample: WheelSample) -> None:
        travelled, turned = self._travelled, self._turned
        if not travelled.t_ns:
            travelled.append(sample.t_ns, 0.0)
            turned.append(sample.t_ns, 0.0)
        else:
            interval_s = seconds(sample.t_ns - travelled.t_ns[-1])
            travelled.append(sample.t_ns, travelled.values[-1] + sample.speed_m_s * interval_s)
            turned.append(sample.t_ns, turned.values[-1] + sample.yaw_rate_rad_s * interval_s)
        self._speeds.append((sample.speed_m_s, sample.yaw_rate_rad_s))

    def running_s(self, t_ns: int) -> float:
        """Return the time for which the gyro has been running, from the very first IMU sample on."""
        return self._running_s + (seconds(t_ns - self.start_ns) if self.start_ns is not None else 0.0)

    def covered_until_ns(self) -> int | None:
        """Return the time up to which a block can be cut now; None before the first IMU sample."""
        if not self._imu_ns:
            return None
        imu_ns = self._imu_ns[-1]
        if not self._travelled.t_ns:
            return imu_ns
        wheels_ns = self._travelled.t_ns[-1]
        return min(imu_ns, max(wheels_ns, imu_ns - WHEEL_TIMEOUT_NS))

    def pause_end_ns(self, t_ns: int) -> int | None:
        """Return the next IMU sample, if it follows on a pause that includes a time; None without a pause."""
        after = bisect_right(self._imu_ns, t_ns)
        if not 0 < after < len(self._imu_ns):
            return None
        end_ns = self._imu_ns[after]
        return end_ns if end_ns - self._imu_ns[after - 1] > PAUSE_NS else None

    def cut(self, start_ns: int, end_ns: int) -> MotionBlock:
        """Cut the block from `start_ns` to `end_ns` and drop the samples before its end."""
        block = self.look(start_ns, end_ns)
        if len(block.dt_s) > 2:  # fewer samples do not determine the vibration
            self._vibration_m2_s4 = float(block.vibration_m2_s4[0])
        self._lead_rad = self._lead_at(end_ns)
        self.forget_before(end_ns)
        return block

    def look(self, start_ns: int, end_ns: int) -> MotionBlock:
        """Return the block from `start_ns` to `end_ns` without dropping samples."""
        assert self.start_ns is not None and end_ns > start_ns
        first, last = bisect_right(self._imu_ns, start_ns), bisect_left(self._imu_ns, end_ns)
        nodes = [self._imu_at(start_ns), *self._imu[first:last], self._imu_at(end_ns)]
        times_ns = [start_ns, *self._imu_ns[first:last], end_ns]
        middle_ns, dt_s, rate_rad_s, acceleration_rad_s2, force_m_s2, scatter_m2_s4, *by_wheels = intervals(
            times_ns, nodes, self._travelled.t_ns, self._travelled.values, self._turned.values
        )
        distance_m, wheel_turn_rad = by_wheels
        rate_rad_s[:, 2] -= (self._lead_at(end_ns) - self._lead_rad) / seconds(end_ns - start_ns)
        covariates = {name: signal.at(start_ns, middle_ns) for name, signal in self._covariates.items()}
        covariates[SPEED_SIGNAL] = distance_m / dt_s
        return MotionBlock(
            start_ns=start_ns,
            end_ns=end_ns,
            time_s=self.running_s(start_ns) + middle_ns / NS_PER_S,
            dt_s=dt_s,
            rate_rad_s=rate_rad_s,
            yaw_acceleration_rad_s2=acceleration_rad_s2,
            specific_force_m_s2=force_m_s2,
            vibration_m2_s4=constant(self._vibration(scatter_m2_s4, seconds(end_ns - start_ns)), len(dt_s)),
            distance_m=distance_m,
            wheel_turn_rad=wheel_turn_rad,
            temperature_c=(
                self._temperature.at(start_ns, middle_ns)
                if self._temperature.t_ns
                else constant(math.nan, len(dt_s))
            ),
            covariates=covariates,
            gap_s=self._gap_s(start_ns, end_ns),
            wheel_gap_s=self._wheel_gap_s(start_ns, end_ns),
            wheels_at_rest=self._wheels_at_rest(start_ns, end_ns),
        )

    def _imu_at(self, t_ns: int) -> tuple[float, ...]:
        """Return rates and specific force at a time, interpolated linearly; without turning in a pause."""
        after = bisect_left(self._imu_ns, t_ns)
        if after == len(self._imu_ns):
            return self._imu[-1]
        if after == 0 or self._imu_ns[after] == t_ns:
            return self._imu[after]
        earlier_ns, later_ns = self._imu_ns[after - 1], self._imu_ns[after]
        if later_ns - earlier_ns > PAUSE_NS:
            return 0.0, 0.0, 0.0, *self._imu[after - 1][3:]
        part = (t_ns - earlier_ns) / (later_ns - earlier_ns)
        before = self._imu[after - 1]
        return tuple([a + part * (b - a) for a, b in zip(before, self._imu[after], strict=True)])

    def _lead_at(self, t_ns: int) -> float:
        """Return the turn by which interpolated rates lead at a time, see `LEAD_PART`; zero in a gap.

        In a dropout the lead is that of the usual intervals before.
        """
        after = min(bisect_left(self._imu_ns, t_ns), len(self._imu_ns) - 1)
        interval_ns = self._imu_ns[after] - self._imu_ns[after - 1] if after else 0
        if not 0 < interval_ns <= GAP_NS:
            return 0.0
        acceleration = (self._imu[after][2] - self._imu[after - 1][2]) / seconds(interval_ns)
        return LEAD_PART * (min(interval_ns, self._usual_interval_ns) / NS_PER_S) ** 2 * acceleration

    def _vibration(self, scatter_m2_s4: float, duration_s: float) -> float:
        """Return the vibration after a block whose samples scatter by this: with exponential forgetting."""
        kept = self._vibration_m2_s4
        if math.isnan(scatter_m2_s4):
            return kept or 0.0
        if kept is None:
            return scatter_m2_s4
        return scatter_m2_s4 + math.exp(-duration_s / VIBRATION_S) * (kept - scatter_m2_s4)

    def _gap_s(self, start_ns: int, end_ns: int) -> float:
        """Return the time without samples: in gaps, before the first and after the last sample.

        Dropouts are weighted by their length, see `DROPOUT_S`.
        """
        first, last = bisect_right(self._imu_ns, start_ns) - 1, bisect_left(self._imu_ns, end_ns)
        around = self._imu_ns[max(first, 0) : last + 1]
        least_ns = max(DROPOUT_INTERVALS * self._usual_interval_ns, MIN_DROPOUT_NS)
        long = [(a, b) for a, b in pairwise(around) if b - a > min(least_ns, GAP_NS)]
        if not long and around[0] <= start_ns and around[-1] >= end_ns:
            return 0.0
        wide = [(a, b) for a, b in long if b - a > GAP_NS]
        unknown = [(start_ns, around[0]), *wide, (around[-1], end_ns)]
        gap_s = seconds(sum(max(min(b, end_ns) - max(a, start_ns), 0) for a, b in unknown))
        dropouts = [(a, b) for a, b in long if least_ns < b - a <= GAP_NS]
        weighted_s = (
            seconds(min(b, end_ns) - max(a, start_ns)) * seconds(b - a) / DROPOUT_S for a, b in dropouts
        )
        return gap_s + sum(max(part_s, 0.0) for part_s in weighted_s)

    def _wheel_gap_s(self, start_ns: int, end_ns: int) -> float:
        track = self._travelled.t_ns
        if not track:
            return seconds(end_ns - start_ns)
        return seconds(max(end_ns - max(start_ns, track[-1]), 0))

    def _wheels_at_rest(self, start_ns: int, end_ns: int) -> bool:
        """Return True if every encoder interval that overlaps the block is without motion."""
        track = self._travelled.t_ns
        if not track or track[-1] < end_ns:
            return False
        first, last = bisect_right(track, start_ns), bisect_left(track, end_ns)
        return not any(speed or yaw_rate for speed, yaw_rate in self._speeds[first : last + 1])

    def forget_before(self, t_ns: int) -> None:
        """Drop the samples that no block from a time on requires."""
        first = max(bisect_right(self._imu_ns, t_ns) - 1, 0)
        del self._imu_ns[:first], self._imu[:first]
        kept = len(self._travelled.t_ns)
        self._travelled.forget_before(t_ns)
        self._turned.forget_before(t_ns)
        del self._speeds[: kept - len(self._travelled.t_ns)]
        self._temperature.forget_before(t_ns)
        for signal in self._covariates.values():
            signal.forget_before(t_ns)


@compiled
def intervals(
    times_ns: list[int],
    nodes: list[tuple[float, ...]],
    wheels_ns: list[int],
    travelled_m: list[float],
    turned_rad: list[float],
) -> tuple[Any, ...]:
    """Return the columns of the N intervals between samples.

    Args:
        times_ns: N + 1 times: start of the block, of the samples inside, end of the block.
        nodes: N + 1 times rates about x, y, z and specific forces along them.
        wheels_ns: times of the wheel encoders.
        travelled_m: way by the wheels until then.
        turned_rad: turn by the wheels until then.

    Returns:
        (N,) middles of the intervals in ns since the first time, (N,) their lengths in s, (N, 3) mean rates,
        (N,) yaw accelerations, (N, 3) mean specific forces, half the mean square of the differences of the
        specific force between successive samples, NaN with fewer than two, and (N,) ways and (N,) turns by
        the wheels, zero with fewer than two of their samples.
    """
    offsets_ns = np.array([t - times_ns[0] for t in times_ns], float)
    values = np.array(nodes)
    middle_ns = 0.5 * (offsets_ns[1:] + offsets_ns[:-1])
    means = 0.5 * (values[1:] + values[:-1])
    dt_s = (offsets_ns[1:] - offsets_ns[:-1]) / NS_PER_S
    acceleration_rad_s2 = (values[1:, 2] - values[:-1, 2]) / dt_s
    steps = values[2:-1, 3:] - values[1:-2, 3:]
    scatter = 0.5 * float(np.vdot(steps, steps)) / len(steps) if len(steps) else math.nan
    by_wheels = np.zeros((2, len(dt_s)))
    if len(wheels_ns) > 1:
        totals = (interpolate(times_ns[0], offsets_ns, wheels_ns, of) for of in (travelled_m, turned_rad))
        by_wheels = np.diff(np.array([*totals]))
    return middle_ns, dt_s, means[:, :3], acceleration_rad_s2, means[:, 3:], scatter, *by_wheels


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
