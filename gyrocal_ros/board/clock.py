"""The board's clock becomes the clock of the stamps, whatever the way from the board adds.

A frame arrives some time after its measurement: on the way it waits for the wire, the USB host and
the operating system. It may wait long, but never less than nothing. So the fastest arrivals tell
what the board's clock read when: over a sliding window, arrival less board time is bounded from
below by a line, whose height is the offset of the two clocks and whose slope is their drift. Of the
edges of the lower convex hull, the one over the middle of the window lies closest to all arrivals.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import TypeAlias

from gyrocal_ros.data import NS_PER_S

WINDOW_NS = 60 * NS_PER_S
"""Older arrivals say nothing of the drift of today."""
BIN_NS = NS_PER_S // 4
"""The fastest arrival of so long a time stands for all of it."""
MOST_DRIFT = 2e-4
"""Two crystals of 100 ppm that are off to either side."""
SLACK_NS = NS_PER_S // 4
"""Board times may run back, and ahead of their arrivals, by so much before they are odd."""
LATE_NS = NS_PER_S // 20
"""Arrivals later than this are a backlog, or, when they stay so, a step of the arrivals' clock."""
PATIENCE_NS = 2 * NS_PER_S
"""How long they may stay so."""
NEARER = 0.75
"""A delay that has come down to this part of what it was is that of a backlog."""
PAUSE_NS = NS_PER_S
"""After so long without arrivals a backlog is to be expected, and patience begins anew."""

NS_PER_US = 1000
US_WRAP = 1 << 32
"""The board's counter has 32 bits."""

Point: TypeAlias = tuple[int, int]
"""Board time, and arrival less board time, both in ns."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """When a measurement was made."""

    t_ns: int
    base: int
    """Number of the time base. Between stamps of two bases the board was started anew or the clock
    of the arrivals was set, so that their difference means nothing."""


class Restart(StrEnum):
    """Why a new time base was begun."""

    BOARD = 'the board was started anew'
    ARRIVALS = 'the clock of the arrivals was set'


def lower_hull(points: list[Point]) -> list[Point]:
    """Return the corners of the lower convex hull of points that are sorted."""
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
    """Return the slope of the edge over the middle of a hull of two corners or more."""
    middle = (hull[0][0] + hull[-1][0]) // 2
    (x0, y0), (x1, y1) = next(edge for edge in pairwise(hull) if edge[1][0] >= middle)
    return (y1 - y0) / (x1 - x0)


class Envelope:
    """The line that all arrivals of the window lie on or above."""

    def __init__(self, first: Point, drift: float = 0.0) -> None:
        self.drift = drift
        """Seconds that the arrivals' clock gains on the board's in a second."""
        self._lowest = first
        """The arrival that the line goes through."""
        self._fastest = deque([first])
        """The fastest arrival of each bin."""
        self._bin_start_ns = first[0]

    def delay_ns(self, point: Point) -> int:
        """How long after the fastest would have been there an arrival came."""
        (x, y), (x0, y0) = point, self._lowest
        return y - y0 - round(self.drift * (x - x0))

    def board_ns(self, arrival_ns: int) -> int:
        """Board time of a measurement that took the fastest way, drift since the window left out."""
        return arrival_ns - self._lowest[1]

    def add(self, point: Point) -> None:
        """Take one more arrival into account."""
        if point[0] >= self._bin_start_ns + BIN_NS:
            self._forget(point[0] - WINDOW_NS)
            self._fit()
            self._bin_start_ns = point[0]
            self._fastest.append(point)
        elif self.delay_ns(point) < self.delay_ns(self._fastest[-1]):
            self._fastest[-1] = point
        if self.delay_ns(point) < 0:
            self._lowest = point

    def _forget(self, before_ns: int) -> None:
        while len(self._fastest) > 1 and self._fastest[0][0] < before_ns:
            self._fastest.popleft()

    def _fit(self) -> None:
        # A backlog was not fast, and as the newest end of the hull it would count.
        fast = [point for point in self._fastest if self.delay_ns(point) <= LATE_NS]
        points = sorted(fast or self._fastest)
        span_ns = points[-1][0] - points[0][0]
        if span_ns > 0:
            slope = min(max(middle_slope(lower_hull(points)), -MOST_DRIFT), MOST_DRIFT)
            # Over a short time few arrivals were fast, and the slope is mostly chance.
            self.drift += (slope - self.drift) * min(span_ns / WINDOW_NS, 1.0) ** 2
        self._lowest = min(points, key=self.delay_ns)


class Clock:
    """Stamps the measurements of a board that runs by itself.

    Of 200 arrivals a second that are spread evenly over 20 ms, the stamps are within 1 ms ten seconds
    after a time base began and within half of that after a minute. Where fast arrivals are rarer it
    takes longer.

    The stamps of one time base always rise. A wild board time is passed over; when the next one
    agrees with it, the board was started anew: a new time base begins, and stamps go on to rise. A
    new time base also begins when the clock of the arrivals is set. Set forward, that is seen by
    arrivals that stay late; set back, at once, and then the stamps go back with it.
    """

    def __init__(self, fastest_ns: int = 0) -> None:
        """Start without knowing anything.

        Args:
            fastest_ns: how long after its measurement the fastest frame arrives. Arrivals alone
                cannot tell; it is the time that a frame takes on the wire.
        """
        self.odd = 0
        """Board times passed over because they fitted to nothing."""
        self.restarts: Counter[Restart] = Counter()
        self.drift = 0.0
        """Seconds that the clock of the arrivals gains on the board's in a second."""
        self._fastest_ns = fastest_ns
        self._envelope: Envelope | None = None
        self._newest_ns = 0
        self._suspect: tuple[int, int] | None = None
        self._late_since_ns: int | None = None
        self._late_by_ns = 0
        self._arrival_ns: int | None = None
        self._stamp_ns: int | None = None

    def stamp(self, time_us: int, arrival_ns: int) -> Stamp | None:
        """Return when a measurement was made; None where its board time is odd.

        Args:
            time_us: board time of the measurement, 32 bits.
            arrival_ns: when its frame arrived, by the clock that the stamps are to follow.
        """
        since_last_ns = 0 if self._arrival_ns is None else arrival_ns - self._arrival_ns
        self._arrival_ns = arrival_ns
        if since_last_ns < -SLACK_NS:
            self._stamp_ns = None
            self._begin_anew(Restart.ARRIVALS)
        elif since_last_ns > PAUSE_NS:
            self._late_since_ns = None
        envelope, point = self._placed(time_us, arrival_ns)
        if self._is_odd(envelope, point):
            if not self._is_confirmed(time_us, arrival_ns):
                self.odd += 1
                return None
            self._begin_anew(Restart.BOARD)
            envelope, point = self._placed(time_us, arrival_ns)
        elif self._stays_late(envelope, point, arrival_ns):
            self._begin_anew(Restart.ARRIVALS)
            envelope, point = self._placed(time_us, arrival_ns)
        self._suspect = None
        self._newest_ns = max(self._newest_ns, point[0])
        envelope.add(point)
        self.drift = envelope.drift
        return self._rising(arrival_ns - envelope.delay_ns(point) - self._fastest_ns)

    def _begin_anew(self, why: Restart) -> None:
        """Forget the offset; the crystal, and so the drift, is still the same."""
        self.restarts[why] += 1
        self._envelope = None

    def _placed(self, time_us: int, arrival_ns: int) -> tuple[Envelope, Point]:
        """Return the line, begun if there is none, and an arrival with its board time unwrapped.

        Of all times with these 32 bits the one nearest to the arrival is meant.
        """
        if self._envelope is None:
            self._newest_ns = time_us * NS_PER_US
            self._late_since_ns = None
            self._envelope = Envelope((self._newest_ns, arrival_ns - self._newest_ns), self.drift)
        expected_us = self._envelope.board_ns(arrival_ns) // NS_PER_US
        board_ns = (expected_us + _difference_us(time_us, expected_us)) * NS_PER_US
        return self._envelope, (board_ns, arrival_ns - board_ns)

    def _is_odd(self, envelope: Envelope, point: Point) -> bool:
        """Whether a board time runs back or ahead of its arrival, as none of this time base can."""
        return point[0] < self._newest_ns - SLACK_NS or envelope.delay_ns(point) < -SLACK_NS

    def _is_confirmed(self, time_us: int, arrival_ns: int) -> bool:
        """Whether the time before was odd too, and this one follows it."""
        before, self._suspect = self._suspect, (time_us, arrival_ns)
        if before is None:
            return False
        step_ns = _difference_us(time_us, before[0]) * NS_PER_US
        return -SLACK_NS <= step_ns <= arrival_ns - before[1] + SLACK_NS

    def _stays_late(self, envelope: Envelope, point: Point, arrival_ns: int) -> bool:
        """Whether nothing was punctual for long, nor came nearer to it, as a backlog does."""
        delay_ns = envelope.delay_ns(point)
        if delay_ns <= LATE_NS:
            self._late_since_ns = None
        elif self._late_since_ns is None or delay_ns < NEARER * self._late_by_ns:
            self._late_since_ns, self._late_by_ns = arrival_ns, delay_ns
        return self._late_since_ns is not None and arrival_ns - self._late_since_ns > PATIENCE_NS

    def _rising(self, t_ns: int) -> Stamp:
        """Hold back the stamps where the line came down by more than the time between two of them."""
        if self._stamp_ns is not None:
            t_ns = max(t_ns, self._stamp_ns + 1)
        self._stamp_ns = t_ns
        return Stamp(t_ns, self.restarts.total())


def _difference_us(later: int, earlier: int) -> int:
    """How far apart two board times are; 32 bits, to the nearer side."""
    return (later - earlier + US_WRAP // 2) % US_WRAP - US_WRAP // 2
