"""Buffer of samples of the IMU and of slower sensors, which are cut into blocks for the filter."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from itertools import pairwise
from operator import sub

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
from gyrocal_ros.ekf.intervals import PAUSE_NS, interpolate, intervals, usual_interval_ns
from gyrocal_ros.model.faulty_readings import FaultyGyro, FaultyWheels
from gyrocal_ros.model.recording import SPEED_SIGNAL

GAP_NS = 100_000_000
"""Maximum interval between IMU samples; a longer one is a gap."""
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
        if first := max(bisect_right(self.t_ns, t_ns) - 1, 0):
            del self.t_ns[:first], self.values[:first]


class _Odometer:
    """The way and the turn by the wheels: the readings that the next block may require."""

    def __init__(self) -> None:
        self.t_ns: list[int] = []
        self.travelled_m: list[float] = []
        self.turned_rad: list[float] = []
        self._moves: list[bool] = []

    def extend(self, samples: list[WheelSample]) -> None:
        for sample in samples:
            way_m = turn_rad = 0.0
            if self.t_ns:
                interval_s = seconds(sample.t_ns - self.t_ns[-1])
                way_m = self.travelled_m[-1] + sample.speed_m_s * interval_s
                turn_rad = self.turned_rad[-1] + sample.yaw_rate_rad_s * interval_s
            self.t_ns.append(sample.t_ns)
            self.travelled_m.append(way_m)
            self.turned_rad.append(turn_rad)
            self._moves.append(bool(sample.speed_m_s or sample.yaw_rate_rad_s))

    def is_at_rest(self, start_ns: int, end_ns: int) -> bool:
        """Return True if every interval between readings that overlaps a block is without motion."""
        if not self.t_ns or self.t_ns[-1] < end_ns:
            return False
        first, last = bisect_right(self.t_ns, start_ns), bisect_left(self.t_ns, end_ns)
        return True not in self._moves[first : last + 1]

    def gap_s(self, start_ns: int, end_ns: int) -> float:
        """Return the time of a block after the last reading."""
        last_ns = max(start_ns, self.t_ns[-1]) if self.t_ns else start_ns
        return seconds(max(end_ns - last_ns, 0))

    def forget_before(self, t_ns: int) -> None:
        if first := max(bisect_right(self.t_ns, t_ns) - 1, 0):
            del self.t_ns[:first], self.travelled_m[:first], self.turned_rad[:first], self._moves[:first]


class MotionBuffer:
    """Buffers the samples since the last block. Blocks must be cut one after the other.

    Args:
        running_s: time for which the gyro has been running at the first sample.
    """

    def __init__(self, running_s: float = 0.0) -> None:
        self.faulty_gyro, self._faulty_wheels = FaultyGyro(), FaultyWheels()
        self._running_s = running_s
        self._start_ns: int | None = None
        self._new_imu: list[ImuSample] = []
        self._new_wheels: list[WheelSample] = []
        self._imu_ns: list[int] = []
        self._usual_interval_ns = float(GAP_NS)
        self._imu: list[ImuSample] = []
        self._vibration_m2_s4: float | None = None
        self._lead_rad = 0.0
        self._odometer = _Odometer()
        self._temperature = _Signal()
        self._covariates: dict[str, _Signal] = {}

    def add(self, sample: ImuSample | WheelSample | TemperatureSample | CovariateSample) -> None:
        """Add one sample; a sample that is not newer than the last of its kind is ignored."""
        if isinstance(sample, ImuSample):
            self._new_imu.append(sample)
        elif isinstance(sample, WheelSample):
            self._new_wheels.append(sample)
        elif isinstance(sample, TemperatureSample):
            self._temperature.append(sample.t_ns, sample.temperature_c)
        else:
            self._covariates.setdefault(sample.name, _Signal()).append(sample.t_ns, sample.value)

    def _take_up(self) -> None:
        """Take up the samples added since the last call; together they take less time than one by one."""
        if self._new_wheels:
            self._odometer.extend(self._faulty_wheels.sound(self._new_wheels))
            self._new_wheels = []
        if not self._new_imu:
            return
        sound, self._new_imu = self.faulty_gyro.sound(self._new_imu), []
        if sound and self._start_ns is None:
            self._start_ns = sound[0].t_ns
        known = len(self._imu_ns)
        self._imu_ns += [sample.t_ns for sample in sound]
        self._imu += sound
        self._usual_interval_ns = usual_interval_ns(self._imu_ns, max(known, 1), self._usual_interval_ns)

    @property
    def start_ns(self) -> int | None:
        """Time of the very first IMU sample; None before."""
        self._take_up()
        return self._start_ns

    def running_s(self, t_ns: int) -> float:
        """Return the time for which the gyro has been running, from the very first IMU sample on."""
        start_ns = self.start_ns
        return self._running_s + (seconds(t_ns - start_ns) if start_ns is not None else 0.0)

    def covered_until_ns(self) -> int | None:
        """Return the time up to which a block can be cut now; None before the first IMU sample."""
        self._take_up()
        if not self._imu_ns:
            return None
        imu_ns, wheels_ns = self._imu_ns[-1], self._odometer.t_ns
        return min(imu_ns, max(wheels_ns[-1], imu_ns - WHEEL_TIMEOUT_NS)) if wheels_ns else imu_ns

    def may_cover(self, t_ns: int) -> bool:
        """Return True if the newest samples reach a time; they cover it unless they are faulty."""
        imu_ns = _newest_ns(self._new_imu, self._imu_ns)
        if imu_ns is None or imu_ns < t_ns:
            return False
        wheels_ns = _newest_ns(self._new_wheels, self._odometer.t_ns)
        return wheels_ns is None or max(wheels_ns, imu_ns - WHEEL_TIMEOUT_NS) >= t_ns

    def pause_end_ns(self, t_ns: int) -> int | None:
        """Return the next IMU sample, if it follows on a pause that includes a time; None without a pause."""
        self._take_up()
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
        wheels, duration_s = self._odometer, seconds(end_ns - start_ns)
        middle_ns, time_s, dt_s, rates, accelerations, forces, scatter_m2_s4, *by_wheels = intervals(
            self._imu_ns,
            self._imu,
            start_ns,
            end_ns,
            self.running_s(start_ns),
            (self._lead_at(end_ns) - self._lead_rad) / duration_s,
            wheels.t_ns,
            wheels.travelled_m,
            wheels.turned_rad,
        )
        distance_m, wheel_turn_rad, speed_m_s = by_wheels
        covariates = {name: signal.at(start_ns, middle_ns) for name, signal in self._covariates.items()}
        covariates[SPEED_SIGNAL] = speed_m_s
        return MotionBlock(
            start_ns=start_ns,
            end_ns=end_ns,
            time_s=time_s,
            dt_s=dt_s,
            rate_rad_s=rates,
            yaw_acceleration_rad_s2=accelerations,
            specific_force_m_s2=forces,
            vibration_m2_s4=constant(self._vibration(scatter_m2_s4, duration_s), len(dt_s)),
            distance_m=distance_m,
            wheel_turn_rad=wheel_turn_rad,
            temperature_c=(
                self._temperature.at(start_ns, middle_ns)
                if self._temperature.t_ns
                else constant(math.nan, len(dt_s))
            ),
            covariates=covariates,
            gap_s=self._gap_s(start_ns, end_ns),
            wheel_gap_s=wheels.gap_s(start_ns, end_ns),
            wheels_at_rest=wheels.is_at_rest(start_ns, end_ns),
        )

    def _lead_at(self, t_ns: int) -> float:
        """Return the turn by which interpolated rates lead at a time, see `LEAD_PART`; zero in a gap.

        In a dropout the lead is that of the usual intervals before.
        """
        after = min(bisect_left(self._imu_ns, t_ns), len(self._imu_ns) - 1)
        interval_ns = self._imu_ns[after] - self._imu_ns[after - 1] if after else 0
        if not 0 < interval_ns <= GAP_NS:
            return 0.0
        change_rad_s = self._imu[after].rate_rad_s[2] - self._imu[after - 1].rate_rad_s[2]
        interval_s = min(interval_ns, self._usual_interval_ns) / NS_PER_S
        return LEAD_PART * interval_s**2 * change_rad_s / seconds(interval_ns)

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
        long_ns = min(least_ns, GAP_NS)
        has_ends = around[0] <= start_ns and around[-1] >= end_ns
        if has_ends and max(map(sub, around[1:], around), default=0) <= long_ns:
            return 0.0
        long = [(a, b) for a, b in pairwise(around) if b - a > long_ns]
        wide = [(a, b) for a, b in long if b - a > GAP_NS]
        unknown = [(start_ns, around[0]), *wide, (around[-1], end_ns)]
        gap_s = seconds(sum(max(min(b, end_ns) - max(a, start_ns), 0) for a, b in unknown))
        dropouts = [(a, b) for a, b in long if least_ns < b - a <= GAP_NS]
        weighted_s = (
            seconds(min(b, end_ns) - max(a, start_ns)) * seconds(b - a) / DROPOUT_S for a, b in dropouts
        )
        return gap_s + sum(max(part_s, 0.0) for part_s in weighted_s)

    def forget_before(self, t_ns: int) -> None:
        """Drop the samples that no block from a time on requires."""
        self._take_up()
        if first := max(bisect_right(self._imu_ns, t_ns) - 1, 0):
            del self._imu_ns[:first], self._imu[:first]
        self._odometer.forget_before(t_ns)
        self._temperature.forget_before(t_ns)
        for signal in self._covariates.values():
            signal.forget_before(t_ns)


def _newest_ns(new: Sequence[ImuSample | WheelSample], known_ns: list[int]) -> int | None:
    """Return the time of the last sample; None without any."""
    if new:
        return new[-1].t_ns
    return known_ns[-1] if known_ns else None
