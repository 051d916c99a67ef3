"""What a check remembers of a topic: figures that grow with every block of messages, never the messages."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, IntArray, seconds

GAP_PERIODS, GAP_NS = 4.0, NS_PER_S // 10
"""A pause longer than so many usual intervals, and so long, is a gap; a few lost messages are none."""
LONGEST_STEP_S = 0.3
"""Rates are not integrated over longer intervals."""
BIN_NS = NS_PER_S // 2
"""Turns are compared over so long: longer than latencies, shorter than turns."""
CLEAR_TURN_RAD = math.radians(3.0) * BIN_NS / NS_PER_S
"""More than drift and floor make of a bin."""


@dataclass(slots=True)
class WorstCase:
    """How often something happened, and the worst of it."""

    count: int = 0
    worst_s: float = 0.0
    at_ns: int = 0
    """Stamp just before the worst."""

    def add(self, sizes_ns: IntArray, before_ns: IntArray) -> None:
        """Add some of it.

        Args:
            sizes_ns: (n,) how large each is.
            before_ns: (n,) stamp before each.
        """
        if len(sizes_ns):
            self.count += len(sizes_ns)
            worst = int(np.argmax(np.abs(sizes_ns)))
            if abs(sizes_ns[worst]) > abs(self.worst_s) * NS_PER_S:
                self.worst_s, self.at_ns = seconds(int(sizes_ns[worst])), int(before_ns[worst])


@dataclass(slots=True)
class StampStats:
    """The stamps of one topic against each other and against the time of recording."""

    step_ns: int
    """Stamps that run ahead of or behind the time of recording by more than this have jumped."""
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    unset: int = 0
    """Stamps that are zero."""
    period_ns: float = math.nan
    """Usual interval between two messages."""
    repeated: WorstCase = field(default_factory=WorstCase)
    backward: WorstCase = field(default_factory=WorstCase)
    jumped: WorstCase = field(default_factory=WorstCase)
    gap: WorstCase = field(default_factory=WorstCase)
    least_delay_s: float = math.inf
    """Time of recording less stamp."""
    most_delay_s: float = -math.inf
    _last_recorded_ns: int = 0

    def add(self, stamps_ns: IntArray, recorded_ns: IntArray) -> None:
        """Add a block of messages in the order of recording.

        Args:
            stamps_ns: (n,)
            recorded_ns: (n,)
        """
        if self.count == 0:
            self.first_ns, self.period_ns = int(stamps_ns[0]), _usual(np.diff(stamps_ns))
            before, recorded_before = stamps_ns, recorded_ns
        else:
            before = np.concatenate([[self.last_ns], stamps_ns])
            recorded_before = np.concatenate([[self._last_recorded_ns], recorded_ns])
        steps, recorded_steps = np.diff(before), np.diff(recorded_before)
        before = before[:-1]
        jumped = np.abs(steps - recorded_steps) > self.step_ns
        backward = (steps < 0) & ~jumped
        gap = (steps > max(GAP_PERIODS * self.period_ns, GAP_NS)) & ~jumped
        for event, where in (
            (self.repeated, steps == 0),
            (self.backward, backward),
            (self.jumped, jumped),
            (self.gap, gap),
        ):
            event.add(steps[where], before[where])
        delays = recorded_ns - stamps_ns
        self.least_delay_s = min(self.least_delay_s, seconds(int(delays.min())))
        self.most_delay_s = max(self.most_delay_s, seconds(int(delays.max())))
        self.unset += int(np.count_nonzero(stamps_ns == 0))
        self.count += len(stamps_ns)
        self.last_ns, self._last_recorded_ns = int(stamps_ns[-1]), int(recorded_ns[-1])

    @property
    def rate_hz(self) -> float:
        """Messages a second, gaps left out."""
        return NS_PER_S / self.period_ns if self.period_ns > 0.0 else math.nan


def _usual(steps_ns: IntArray) -> float:
    """Mean of the usual intervals: those near the median, so that jitter and gaps do not count."""
    steps = steps_ns[steps_ns > 0]
    if not len(steps):
        return math.nan
    usual = steps[steps < 2.0 * np.median(steps)]
    return float(usual.mean())


@dataclass(slots=True)
class TurnStats:
    """How a sensor says the robot turned, in bins of half a second."""

    bins_rad: defaultdict[int, float] = field(default_factory=lambda: defaultdict(float))
    """Number of the bin since the epoch and the turn in it."""
    _last_ns: int | None = None
    _last_yaw_rad: float = 0.0

    def add(self, stamps_ns: IntArray, yaw_rates_rad_s: Array) -> None:
        """Add a block of rates (n,), each taken to hold for the interval that ends at its stamp (n,)."""
        if len(stamps_ns):
            steps_s = np.diff(stamps_ns, prepend=self._last_ns or stamps_ns[0]) / NS_PER_S
            self._add_turns(
                stamps_ns, yaw_rates_rad_s * np.where(abs(steps_s) < LONGEST_STEP_S, steps_s, 0.0)
            )

    def add_headings(self, stamps_ns: IntArray, yaws_rad: Array) -> None:
        """Add a block of headings (n,) with their stamps (n,)."""
        if len(stamps_ns):
            first = yaws_rad[0] if self._last_ns is None else self._last_yaw_rad
            self._last_yaw_rad = float(yaws_rad[-1])
            self._add_turns(stamps_ns, np.diff(np.unwrap([first, *yaws_rad])))

    def _add_turns(self, stamps_ns: IntArray, turns_rad: Array) -> None:
        self._last_ns = int(stamps_ns[-1])
        numbers, places = np.unique(stamps_ns // BIN_NS, return_inverse=True)
        for number, turn in zip(numbers.tolist(), np.bincount(places, turns_rad).tolist(), strict=True):
            self.bins_rad[number] += turn

    @property
    def left_right_rad(self) -> tuple[float, float]:
        """How far it turned to the left and to the right, drift left out."""
        clear = [turn for turn in self.bins_rad.values() if abs(turn) > CLEAR_TURN_RAD]
        return sum(turn for turn in clear if turn > 0.0), -sum(turn for turn in clear if turn < 0.0)


@dataclass(slots=True)
class ImuStats:
    """What an IMU read, in body axes."""

    R_bi: Array
    """(3, 3) from the IMU's axes to body axes."""
    count: int = 0
    at_zero: int = 0
    """Samples with all three rates exactly zero."""
    largest_rate_rad_s: float = 0.0
    force_sum_m_s2: float = 0.0
    turns: TurnStats = field(default_factory=TurnStats)

    def add(self, stamps_ns: IntArray, readings: Array) -> None:
        """Add a block of samples: stamps (n,), and rates and specific forces (n, 6)."""
        rates = readings[:, :3] @ self.R_bi.T
        self.count += len(rates)
        self.at_zero += int(np.count_nonzero(~rates.any(axis=1)))
        self.largest_rate_rad_s = max(self.largest_rate_rad_s, float(np.abs(rates).max()))
        self.force_sum_m_s2 += float(np.linalg.norm(readings[:, 3:], axis=1).sum())
        self.turns.add(stamps_ns, rates[:, 2])

    @property
    def mean_force_m_s2(self) -> float:
        """Mean size of the specific force; gravity, whichever way it points."""
        return self.force_sum_m_s2 / self.count if self.count else math.nan


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the turns of two sensors compare."""

    ratio: float
    """Turn by the other over turn by this one, from bin to bin."""
    correlation: float
    this_deg: float
    """How far each turned in all, to both sides."""
    other_deg: float


def compare_turns(this: TurnStats, other: TurnStats) -> Agreement | None:
    """Compare two sensors over the time that both saw; None where one of them saw no turn."""
    common = sorted(this.bins_rad.keys() & other.bins_rad.keys())
    a = np.array([this.bins_rad[number] for number in common])
    b = np.array([other.bins_rad[number] for number in common])
    if len(common) < 10:
        return None
    a, b = a - a.mean(), b - b.mean()
    aa, bb, ab = float(a @ a), float(b @ b), float(a @ b)
    least = len(common) * math.radians(0.5) ** 2
    if max(aa, bb) < least or min(aa, bb) == 0.0:
        return None
    return Agreement(
        ratio=math.copysign(math.sqrt(bb / aa), ab),
        correlation=ab / math.sqrt(aa * bb),
        this_deg=math.degrees(sum(this.left_right_rad)),
        other_deg=math.degrees(sum(other.left_right_rad)),
    )
