"""Conversion of board times to stamps of the host clock.

A frame arrives some time after its measurement: it waits for the wire, the USB host and the operating
system. The delay may be long, but it is never negative. The fastest arrivals therefore determine the
relation of the two clocks: over a sliding window, (arrival - board time) is bounded from below by a
line whose height is the clock offset and whose slope is the clock drift. Of the edges of the lower
convex hull, the one over the middle of the window is the closest to all arrivals.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import TypeAlias

from gyrocal_ros.data import NS_PER_S

WINDOW_NS = 60 * NS_PER_S
"""Length of the sliding window. Older arrivals are not representative of the present drift."""
BIN_NS = NS_PER_S // 4
"""Length of a bin, of which only the fastest arrival is kept."""
MAX_DRIFT = 2e-4
"""Limit of the estimated drift: two crystals of 100 ppm with errors of opposite sign."""
TOLERANCE_NS = NS_PER_S // 4
"""Largest backward step of the board time, and largest lead over its arrival, that is not an outlier."""
LATE_NS = NS_PER_S // 20
"""Delay above which an arrival is late. Late arrivals are a backlog or, if they persist, a step of the
host clock."""
LATE_TIMEOUT_NS = 2 * NS_PER_S
"""Time for which all arrivals may be late before a step of the host clock is assumed."""
BACKLOG_SHRINKAGE = 0.75
"""Ratio of a delay to an earlier one below which the delay is shrinking, as that of a backlog does."""
PAUSE_NS = NS_PER_S
"""Time without arrivals after which a backlog is expected and the late timeout restarts."""

NS_PER_US = 1000
US_WRAP = 1 << 32
"""Period of the board's 32-bit counter."""

Point: TypeAlias = tuple[int, int]
"""Board time, and arrival minus board time, both in ns."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """Time of a measurement."""

    t_ns: int
    base: int
    """Number of the time base. The difference of stamps of two time bases is meaningless: in between,
    the board was restarted or the host clock was set."""


class RestartCause(StrEnum):
    """Reason for a new time base."""

    BOARD = 'the board was restarted'
    ARRIVALS = 'the host clock was set'


def lower_hull(points: list[Point]) -> list[Point]:
    """Return the corners of the lower convex hull of sorted points."""
    hull: list[Point] = []
    for x, y in points:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


def middle_slope(hull: list[Point]) -> float:
    """Return the slope of the edge over the middle of a hull with two or more corners."""
    middle = (hull[0][0] + hull[-1][0]) // 2
    (x0, y0), (x1, y1) = next(edge for edge in pairwise(hull) if edge[1][0] >= middle)
    return (y1 - y0) / (x1 - x0)


class Envelope:
    """Lower bound of the arrivals in the window: the line that all of them are on or above."""

    def __init__(self, first: Point, drift: float = 0.0) -> None:
        self.drift = drift
        """Drift of the host clock against the board clock, seconds per second."""
        self._lowest = first
        """Arrival that the line passes through."""
        self._fastest = deque([first])
        """Fastest arrival of each bin."""
        self._bin_start_ns = first[0]

    def delay_ns(self, point: Point) -> int:
        """Return the delay of an arrival relative to the fastest possible one."""
        (x, y), (x0, y0) = point, self._lowest
        return y - y0 - round(self.drift * (x - x0))

    def board_ns(self, arrival_ns: int) -> int:
        """Return the board time of a measurement with the smallest delay.

        The drift since the window is ignored.
        """
        return arrival_ns - self._lowest[1]

    def add(self, point: Point) -> None:
        """Add one arrival."""
        if point[0] >= self._bin_start_ns + BIN_NS:
            self._drop_before(point[0] - WINDOW_NS)
            self._fit()
            self._bin_start_ns = point[0]
            self._fastest.append(point)
        elif self.delay_ns(point) < self.delay_ns(self._fastest[-1]):
            self._fastest[-1] = point
        if self.delay_ns(point) < 0:
            self._lowest = point

    def _drop_before(self, before_ns: int) -> None:
        while len(self._fastest) > 1 and self._fastest[0][0] < before_ns:
            self._fastest.popleft()

    def _fit(self) -> None:
        # A backlog is not fast, but as the newest end of the hull it would affect the slope.
        fast = [point for point in self._fastest if self.delay_ns(point) <= LATE_NS]
        points = sorted(fast or self._fastest)
        span_ns = points[-1][0] - points[0][0]
        if span_ns > 0:
            slope = min(max(middle_slope(lower_hull(points)), -MAX_DRIFT), MAX_DRIFT)
            # A short span holds few fast arrivals, so that its slope is mostly noise.
            self.drift += (slope - self.drift) * min(span_ns / WINDOW_NS, 1.0) ** 2
        self._lowest = min(points, key=self.delay_ns)


class Clock:
    """Stamps the measurements of a board with a free-running clock.

    If 200 arrivals per second are spread evenly over 20 ms, the stamps are within 1 ms of the true time
    ten seconds after the start of a time base, and within half of that after a minute. It takes longer
    if fast arrivals are rarer.

    The stamps of one time base increase strictly. A single outlying board time is rejected. If the next
    one is consistent with it, the board was restarted: a new time base begins, and the stamps continue
    to increase. A new time base also begins if the host clock is set. A forward step is detected by
    arrivals that stay late; a backward step is detected at once, and the stamps step back with it.
    """

    def __init__(self, fastest_ns: int = 0) -> None:
        """Start without an offset estimate.

        Args:
            fastest_ns: delay of the fastest frame. It cannot be estimated from arrivals alone; it is
                the transmission time of a frame.
        """
        self.outliers = 0
        """Number of board times rejected because they were consistent with nothing."""
        self.restarts: Counter[RestartCause] = Counter()
        self.drift = 0.0
        """Drift of the host clock against the board clock, seconds per second."""
        self._fastest_ns = fastest_ns
        self._envelope: Envelope | None = None
        self._newest_ns = 0
        self._last_outlier: tuple[int, int] | None = None
        self._late_since_ns: int | None = None
        self._late_by_ns = 0
        self._arrival_ns: int | None = None
        self._stamp_ns: int | None = None

    def stamp(self, time_us: int, arrival_ns: int) -> Stamp | None:
        """Return the stamp of a measurement, or None if its board time is an outlier.

        Args:
            time_us: board time of the measurement, 32 bits.
            arrival_ns: arrival time of its frame on the host clock that the stamps follow.
        """
        since_last_ns = 0 if self._arrival_ns is None else arrival_ns - self._arrival_ns
        self._arrival_ns = arrival_ns
        if since_last_ns < -TOLERANCE_NS:
            self._stamp_ns = None
            self._begin_time_base(RestartCause.ARRIVALS)
        elif since_last_ns > PAUSE_NS:
            self._late_since_ns = None
        envelope, point = self._unwrapped(time_us, arrival_ns)
        if self._is_outlier(envelope, point):
            if not self._is_confirmed(time_us, arrival_ns):
                self.outliers += 1
                return None
            self._begin_time_base(RestartCause.BOARD)
            envelope, point = self._unwrapped(time_us, arrival_ns)
        elif self._is_persistently_late(envelope, point, arrival_ns):
            self._begin_time_base(RestartCause.ARRIVALS)
            envelope, point = self._unwrapped(time_us, arrival_ns)
        self._last_outlier = None
        self._newest_ns = max(self._newest_ns, point[0])
        envelope.add(point)
        self.drift = envelope.drift
        return self._monotonic_stamp(arrival_ns - envelope.delay_ns(point) - self._fastest_ns)

    def _begin_time_base(self, why: RestartCause) -> None:
        """Discard the offset. The crystal, and so the drift, is still the same."""
        self.restarts[why] += 1
        self._envelope = None

    def _unwrapped(self, time_us: int, arrival_ns: int) -> tuple[Envelope, Point]:
        """Return the envelope, created if there is none, and an arrival with its unwrapped board time.

        Of all times with these 32 bits the one nearest to the arrival is taken.
        """
        if self._envelope is None:
            self._newest_ns = time_us * NS_PER_US
            self._late_since_ns = None
            self._envelope = Envelope((self._newest_ns, arrival_ns - self._newest_ns), self.drift)
        expected_us = self._envelope.board_ns(arrival_ns) // NS_PER_US
        board_ns = (expected_us + _difference_us(time_us, expected_us)) * NS_PER_US
        return self._envelope, (board_ns, arrival_ns - board_ns)

    def _is_outlier(self, envelope: Envelope, point: Point) -> bool:
        """Return whether a board time is outside this time base.

        It is if it runs back, or ahead of its arrival, by more than the tolerance.
        """
        return point[0] < self._newest_ns - TOLERANCE_NS or envelope.delay_ns(point) < -TOLERANCE_NS

    def _is_confirmed(self, time_us: int, arrival_ns: int) -> bool:
        """Return whether the previous board time was also an outlier and this one is consistent with it."""
        before, self._last_outlier = self._last_outlier, (time_us, arrival_ns)
        if before is None:
            return False
        step_ns = _difference_us(time_us, before[0]) * NS_PER_US
        return -TOLERANCE_NS <= step_ns <= arrival_ns - before[1] + TOLERANCE_NS

    def _is_persistently_late(self, envelope: Envelope, point: Point, arrival_ns: int) -> bool:
        """Return whether all arrivals have been late for the timeout without a shrinking delay.

        The delay of a backlog shrinks while it is transmitted; that of a clock step does not.
        """
        delay_ns = envelope.delay_ns(point)
        if delay_ns <= LATE_NS:
            self._late_since_ns = None
        elif self._late_since_ns is None or delay_ns < BACKLOG_SHRINKAGE * self._late_by_ns:
            self._late_since_ns, self._late_by_ns = arrival_ns, delay_ns
        return self._late_since_ns is not None and arrival_ns - self._late_since_ns > LATE_TIMEOUT_NS

    def _monotonic_stamp(self, t_ns: int) -> Stamp:
        """Return the stamp, delayed if necessary so that it is later than the previous one.

        The envelope may step down by more than the time between two measurements.
        """
        if self._stamp_ns is not None:
            t_ns = max(t_ns, self._stamp_ns + 1)
        self._stamp_ns = t_ns
        return Stamp(t_ns, self.restarts.total())


def _difference_us(later: int, earlier: int) -> int:
    """Return the signed difference of two 32-bit board times, modulo the wrap."""
    return (later - earlier + US_WRAP // 2) % US_WRAP - US_WRAP // 2
