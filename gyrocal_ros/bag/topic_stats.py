"""Statistics of one topic, updated with every block of messages; the messages themselves are not kept."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, ImuSample, IntArray, seconds
from gyrocal_ros.model.faulty_readings import MIN_JUMP_RAD_S, FaultyGyro

STEADY_PART = 0.95
"""Part of the mean norm of the specific force that its mean has if the robot keeps its attitude."""
GAP_PERIODS, GAP_NS = 4.0, NS_PER_S // 10
"""Minimum length of a gap, in typical periods and in time: a few lost messages are no gap."""
EVEN_PERIODS = (0.5, 1.5)
"""Interval between two messages, in typical periods, that counts as regular."""
LOST_PERIODS = 0.1
"""Difference of an interval from whole periods below which messages between are lost, or recorded later."""
MAX_STEP_S = 0.3
"""Longest interval over which a rate is integrated."""
MAX_DELAY_NS = 5 * NS_PER_S
"""Longest delay of a message that is left out; an earlier stamp is a step of the clock."""
BIN_NS = NS_PER_S // 2
"""Length of the bins in which turns are compared: longer than latencies, shorter than turns."""
MIN_BIN_TURN_RAD = math.radians(3.0) * BIN_NS / NS_PER_S
"""Threshold above which a bin counts as turning: above what gyro drift and an uneven floor cause."""
MIN_COMMON_BINS = 10
"""Minimum number of common bins for comparing two sensors."""
AGREEING_CORRELATION = 0.95
"""Correlation from which two sensors are not compared in other ways."""
JOINED_BINS, MAX_LAG_BINS = (1, 4, 8), 2
"""Numbers of bins that are joined, and by how many a sensor is moved, where they do not agree."""
DELAY_LAGS, MIN_DELAY_BINS, MIN_CONDITION = 2, 40, 1e-3
"""Largest lag, in bins, of the regression that measures a delay, with 1 it would be a fifth too large; bins
and condition that it needs: of a steady swing any lag of a period would do."""
MIN_RMS_TURN_RAD = math.radians(0.5)
"""Standard deviation of the turn in a bin that one of two sensors must reach for comparing them."""
MIN_AXIS_CORRELATION = 0.9
"""Correlation of turns from which an axis of the gyro measures the turns of the robot."""


@dataclass(slots=True)
class EventStats:
    """Number of events of one kind, and the largest of them."""

    count: int = 0
    largest_s: float = 0.0
    """Signed size of the largest event."""
    at_ns: int = 0
    """Stamp just before the largest event."""

    def add(self, sizes_ns: IntArray, before_ns: IntArray) -> None:
        """Add events.

        Args:
            sizes_ns: (n,) signed sizes.
            before_ns: (n,) stamps just before the events.
        """
        if len(sizes_ns):
            self.count += len(sizes_ns)
            largest = int(np.argmax(np.abs(sizes_ns)))
            if abs(sizes_ns[largest]) > abs(self.largest_s) * NS_PER_S:
                self.largest_s, self.at_ns = seconds(int(sizes_ns[largest])), int(before_ns[largest])


@dataclass(slots=True)
class StampStats:
    """Statistics of the stamps of one topic: their steps, and their delay to the time of recording."""

    step_ns: int
    """Threshold of a jump: change of the stamps relative to the time of recording."""
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    unset: int = 0
    """Number of stamps that are zero."""
    uneven: int = 0
    """Number of intervals that are neither regular nor one of the events below."""
    lost: int = 0
    """Number of messages that are missing between others."""
    followed_s: float = 0.0
    """Time in which the messages follow each other closely enough to integrate a rate."""
    period_ns: float = math.nan
    """Typical interval between two messages."""
    repeated: EventStats = field(default_factory=EventStats)
    backward: EventStats = field(default_factory=EventStats)
    jumped: EventStats = field(default_factory=EventStats)
    gap: EventStats = field(default_factory=EventStats)
    min_delay_s: float = math.inf
    """Smallest time of recording minus stamp."""
    max_delay_s: float = -math.inf
    """Largest time of recording minus stamp."""
    mean_delay_s: float = 0.0
    """Mean time of recording minus stamp."""
    _first_recorded_ns: int = 0
    _last_recorded_ns: int = 0

    def add(self, stamps_ns: IntArray, recorded_ns: IntArray) -> None:
        """Add a block of messages in the order of recording.

        Args:
            stamps_ns: (n,) stamps.
            recorded_ns: (n,) times of recording.
        """
        if self.count == 0:
            self.first_ns, self.period_ns = int(stamps_ns[0]), _typical_interval_ns(stamps_ns)
            self._first_recorded_ns = int(recorded_ns[0])
            before, recorded_before = stamps_ns, recorded_ns
        else:
            before = np.concatenate([[self.last_ns], stamps_ns])
            recorded_before = np.concatenate([[self._last_recorded_ns], recorded_ns])
        steps, recorded_steps = np.diff(before), np.diff(recorded_before)
        before = before[:-1]
        jumped = np.abs(steps - recorded_steps) > self.step_ns
        backward = (steps < 0) & ~jumped
        gap = (steps > max(GAP_PERIODS * self.period_ns, GAP_NS)) & ~jumped
        gap[1:] &= ~backward[:-1]  # a return to the newest stamps is no gap
        for events, where in (
            (self.repeated, steps == 0),
            (self.backward, backward),
            (self.jumped, jumped),
            (self.gap, gap),
        ):
            events.add(steps[where], before[where])
        self.followed_s += float(steps[(steps > 0) & (steps < MAX_STEP_S * NS_PER_S)].sum()) / NS_PER_S
        resent = backward.copy()
        resent[1:] |= backward[:-1]
        is_even = (steps > EVEN_PERIODS[0] * self.period_ns) & (steps < EVEN_PERIODS[1] * self.period_ns)
        whole = np.rint(steps / self.period_ns) if self.period_ns > 0.0 else np.ones(len(steps))
        is_whole = np.abs(steps - whole * self.period_ns) < LOST_PERIODS * self.period_ns
        self.lost += int(np.sum(whole[is_whole & ~jumped & ~gap] - 1.0))
        is_odd = ~is_even & ~is_whole & (steps > 0)
        self.uneven += int(np.count_nonzero(is_odd & ~jumped & ~gap & ~resent))
        delays = recorded_ns - stamps_ns
        self.min_delay_s = min(self.min_delay_s, seconds(int(delays.min())))
        self.max_delay_s = max(self.max_delay_s, seconds(int(delays.max())))
        self.unset += int(np.count_nonzero(stamps_ns == 0))
        self.count += len(stamps_ns)
        self.mean_delay_s += (delays.mean() / NS_PER_S - self.mean_delay_s) * len(stamps_ns) / self.count
        self.last_ns, self._last_recorded_ns = int(stamps_ns[-1]), int(recorded_ns[-1])

    @property
    def recorded_s(self) -> float:
        """Time of recording from the first message to the last."""
        return seconds(self._last_recorded_ns - self._first_recorded_ns)

    @property
    def rate_hz(self) -> float:
        """Number of messages per second outside gaps."""
        return NS_PER_S / self.period_ns if self.period_ns > 0.0 else math.nan


def _typical_interval_ns(stamps_ns: IntArray) -> float:
    """Return the mean of the intervals below twice their median, which excludes gaps."""
    steps = np.diff(np.unique(stamps_ns))
    if not len(steps):
        return math.nan
    typical = steps[steps < 2.0 * np.median(steps)]
    return float(typical.mean())


@dataclass(slots=True)
class TurnStats:
    """Turn of the robot measured by one sensor, in bins of half a second."""

    bins_rad: defaultdict[int, float] = field(default_factory=lambda: defaultdict(float))
    """Turn in each bin, by the number of the bin since the epoch."""
    _last_ns: int | None = None
    _last_yaw_rad: float = 0.0

    def add(self, stamps_ns: IntArray, yaw_rates_rad_s: Array) -> None:
        """Add a block of yaw rates (n,), each constant over the interval that ends at its stamp (n,).

        Messages that come late or again are sorted in within the block, and left out if they are of the time
        of the block before.
        """
        if self._last_ns is not None:
            is_new = np.abs(stamps_ns - self._last_ns + MAX_DELAY_NS // 2) > MAX_DELAY_NS // 2
            stamps_ns, yaw_rates_rad_s = stamps_ns[is_new], yaw_rates_rad_s[is_new]
        stamps_ns, order = np.unique(stamps_ns, return_index=True)
        yaw_rates_rad_s = yaw_rates_rad_s[order]
        if len(stamps_ns):
            steps_s = np.diff(stamps_ns, prepend=self._last_ns or stamps_ns[0]) / NS_PER_S
            self._add_turns(stamps_ns, yaw_rates_rad_s * np.where(abs(steps_s) < MAX_STEP_S, steps_s, 0.0))

    def add_headings(self, stamps_ns: IntArray, yaws_rad: Array) -> None:
        """Add a block of headings (n,) with their stamps (n,)."""
        if len(stamps_ns):
            first = yaws_rad[0] if self._last_ns is None else self._last_yaw_rad
            self._last_yaw_rad = float(yaws_rad[-1])
            self._add_turns(stamps_ns, np.diff(np.unwrap([first, *yaws_rad])))

    def _add_turns(self, stamps_ns: IntArray, turns_rad: Array) -> None:
        self._last_ns = int(stamps_ns[-1])
        numbers, indices = np.unique(stamps_ns // BIN_NS, return_inverse=True)
        for number, turn in zip(numbers.tolist(), np.bincount(indices, turns_rad).tolist(), strict=True):
            self.bins_rad[number] += turn

    @property
    def left_right_rad(self) -> tuple[float, float]:
        """Total turn to the left and to the right, over the bins that count as turning."""
        turning = [turn for turn in self.bins_rad.values() if abs(turn) > MIN_BIN_TURN_RAD]
        return sum(turn for turn in turning if turn > 0.0), -sum(turn for turn in turning if turn < 0.0)


@dataclass(slots=True)
class ImuStats:
    """Statistics of the readings of an IMU, in body axes."""

    R_bi: Array
    """(3, 3) from the IMU's axes to body axes."""
    count: int = 0
    """Number of samples."""
    zero_count: int = 0
    """Number of samples with all three rates exactly zero."""
    faulty: FaultyGyro = field(default_factory=FaultyGyro)
    """Readings that the filter leaves out."""
    largest_rate_rad_s: float = 0.0
    force_sum_m_s2: float = 0.0
    direction_sum_m_s2: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) sum of the specific forces in body axes."""
    axis_turns: tuple[TurnStats, TurnStats, TurnStats] = field(
        default_factory=lambda: (TurnStats(), TurnStats(), TurnStats())
    )
    """Turns about the x, y and z axes."""

    @property
    def turns(self) -> TurnStats:
        """Turns about the vertical."""
        return self.axis_turns[2]

    def add(self, stamps_ns: IntArray, readings: Array) -> None:
        """Add a block of samples: stamps (n,), and rates and specific forces (n, 6)."""
        rates = readings[:, :3] @ self.R_bi.T
        self.count += len(rates)
        self.zero_count += int(np.count_nonzero(~rates.any(axis=1)))
        self.largest_rate_rad_s = max(self.largest_rate_rad_s, float(np.abs(rates).max()))
        self.force_sum_m_s2 += float(np.linalg.norm(readings[:, 3:], axis=1).sum())
        self.direction_sum_m_s2 = self.direction_sum_m_s2 + self.R_bi @ readings[:, 3:].sum(axis=0)
        for turns, axis_rates in zip(self.axis_turns, rates.T, strict=True):
            turns.add(stamps_ns, axis_rates)
        steps = np.diff(rates, axis=0)  # without a jump or a repetition no reading of the block is faulty
        if (np.abs(steps[:, 2]) > MIN_JUMP_RAD_S).any() or not steps.any(axis=1).all():
            at_rest = (0.0, 0.0, 0.0)
            samples = zip(stamps_ns.tolist(), rates.tolist(), strict=True)
            self.faulty.sound([ImuSample(t_ns, tuple(rate), at_rest) for t_ns, rate in samples])

    def turning_axis(self, other: TurnStats) -> str:
        """Return the horizontal axis, with its sign, that turns as another sensor; empty if none does."""
        for name, turns in zip('xy', self.axis_turns, strict=False):
            compared = compare_turns(turns, other)
            if compared is not None and abs(compared.correlation) > MIN_AXIS_CORRELATION:
                return name if compared.correlation > 0.0 else f'-{name}'
        return ''

    @property
    def mean_force_m_s2(self) -> float:
        """Mean norm of the specific force: gravity, independent of the mounting."""
        return self.force_sum_m_s2 / self.count if self.count else math.nan

    @property
    def tilt_rad(self) -> float:
        """Angle between the mean specific force and the vertical axis; NaN where the forces cancel out."""
        x, y, z = self.direction_sum_m_s2.tolist()
        is_steady = math.hypot(x, y, z) > STEADY_PART * self.force_sum_m_s2
        return math.atan2(math.hypot(x, y), abs(z)) if is_steady else math.nan


@dataclass(frozen=True, slots=True)
class TurnComparison:
    """Comparison of the turns that two sensors measured."""

    ratio: float
    """Turn of the other sensor over turn of this one, from the scatter over the bins."""
    correlation: float
    this_deg: float
    """Total turn of this sensor, to both sides."""
    other_deg: float
    """Total turn of the other sensor, to both sides."""


@dataclass(frozen=True, slots=True)
class TurnDelay:
    """By how much the turns of one sensor are behind those of another one."""

    delay_s: float
    std_s: float


def compare_turns(this: TurnStats, other: TurnStats) -> TurnComparison | None:
    """Compare two sensors over their common time.

    A rare one is compared over longer bins. Where they do not agree, other bins and delays of up to a second
    are tried: a late sensor is no wrong one.

    Returns:
        The comparison with the largest correlation; None if the common time is too short, if neither sensor
        turned enough, or if the turn of one of them is the same in all bins.
    """
    spacing = max(_spacing(this), _spacing(other))
    widths = [joined for joined in JOINED_BINS if spacing == 1 or joined >= 4 * spacing] or JOINED_BINS[-1:]
    best = _compare(this, other, widths[0], 0)
    if best is None or abs(best.correlation) > AGREEING_CORRELATION:
        return best
    lags = range(-MAX_LAG_BINS, MAX_LAG_BINS + 1)
    moved = (_compare(this, other, joined, lag) for joined in widths for lag in lags)
    return max(filter(None, (best, *moved)), key=lambda item: abs(item.correlation))


def turn_delay(this: TurnStats, other: TurnStats) -> TurnDelay | None:
    """Return by how much the turns of one sensor are behind those of another one.

    Turns that come a part of a bin late are in that bin and in the next one. So the turn in a bin by the late
    sensor is regressed on those in the bins around by the other one; the delay is the mean of the lags.

    Returns:
        None where the common time is too short, or the turns are too small or do not agree.
    """
    lags = np.arange(-DELAY_LAGS, DELAY_LAGS + 1)
    bins = this.bins_rad
    common = [number for number in sorted(other.bins_rad) if {*(number - lags).tolist()} <= bins.keys()]
    if len(common) < MIN_DELAY_BINS:
        return None
    turns = np.array(
        [[bins[number] for number in row] for row in (np.array(common)[:, None] - lags).tolist()]
    )
    measured = np.array([other.bins_rad[number] for number in common])
    turns, measured = turns - turns.mean(axis=0), measured - measured.mean()
    if min(np.var(turns), np.var(measured)) < MIN_RMS_TURN_RAD**2:
        return None
    parts, _, rank, _ = np.linalg.lstsq(turns, measured, rcond=MIN_CONDITION)
    left = measured - turns @ parts
    if rank < len(lags) or left @ left > (1.0 - AGREEING_CORRELATION**2) * (measured @ measured):
        return None
    covariance = np.linalg.inv(turns.T @ turns) * (left @ left) / (len(common) - len(lags))
    mean_lag = lags @ parts / parts.sum()
    by_parts = (lags - mean_lag) / parts.sum()
    bin_s = BIN_NS / NS_PER_S
    return TurnDelay(bin_s * float(mean_lag), bin_s * math.sqrt(by_parts @ covariance @ by_parts))


def _spacing(turns: TurnStats) -> int:
    """Return the distance of bins with samples: more than 1 where samples are rare, some gaps aside."""
    steps = np.diff(sorted(turns.bins_rad))
    return int(np.quantile(steps, 0.9)) if len(steps) else 1


def _compare(this: TurnStats, other: TurnStats, joined: int, lag: int) -> TurnComparison | None:
    """Compare two sensors over bins of which some are joined, the other one moved by a number of bins."""
    first, second = _joined(this.bins_rad, joined, 0), _joined(other.bins_rad, joined, lag)
    common = sorted(first.keys() & second.keys())
    a, b = np.array([first[number] for number in common]), np.array([second[number] for number in common])
    if len(common) < MIN_COMMON_BINS:
        return None
    a, b = a - a.mean(), b - b.mean()
    aa, bb, ab = float(a @ a), float(b @ b), float(a @ b)
    smallest = len(common) * MIN_RMS_TURN_RAD**2
    if max(aa, bb) < smallest or min(aa, bb) == 0.0:
        return None
    return TurnComparison(
        ratio=math.copysign(math.sqrt(bb / aa), ab),
        correlation=ab / math.sqrt(aa * bb),
        this_deg=math.degrees(sum(this.left_right_rad)),
        other_deg=math.degrees(sum(other.left_right_rad)),
    )


def _joined(bins_rad: Mapping[int, float], joined: int, lag: int) -> dict[int, float]:
    """Return the turns in bins of several, those that are at least half complete."""
    turns, counts = defaultdict[int, float](float), defaultdict[int, int](int)
    for number, turn in bins_rad.items():
        turns[(number + lag) // joined] += turn
        counts[(number + lag) // joined] += 1
    return {number: turn for number, turn in turns.items() if 2 * counts[number] >= joined}
