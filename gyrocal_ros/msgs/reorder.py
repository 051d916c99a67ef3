"""Sorts messages by their stamps in a bounded buffer, and detects steps of the clock of the stamps."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Collection, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Generic, TypeAlias, TypeVar

from gyrocal_ros.data import NS_PER_S, ClockStep

T = TypeVar('T')

CONFIRMATION_NS = NS_PER_S // 2
"""Time for which stamps must continue after a jump to confirm a step of the clock.

If they arrive in less than half this time, they were delayed together and confirm nothing.
"""
UNDENIABLE_NS = 10 * NS_PER_S
"""Time for which stamps must continue after a jump to confirm a step whatever the times of arrival are: those
of a converted recording may mean nothing."""
RECENT_INTERVALS = 5
"""Number of recent intervals of a stream whose shortest predicts when its next message is due."""
MAX_BUFFERED = 300_000
"""Limit of the number of buffered messages, for a clock that has stopped."""


class Drop(StrEnum):
    """Reason for dropping a message."""

    LATE = 'late'
    """Newer messages had already been released."""
    DUPLICATE = 'duplicate'
    """The stream already had a message with this stamp."""
    OUTLIER = 'odd_stamp'
    """The stamp is far from those of the messages before and after it."""


Drops: TypeAlias = Counter[tuple[Drop, int]]
"""Number of dropped messages, by reason and stream."""


class _TimeBase(Generic[T]):
    """The messages of one clock, sorted within a window."""

    def __init__(
        self, first_ns: int, arrival_ns: int, window_ns: int, punctual: frozenset[int], drops: Drops
    ) -> None:
        self.first_ns = self.newest_ns = self._next_release_ns = first_ns
        self.newest_arrival_ns = arrival_ns
        self.last_of: dict[int, int] = {}
        """Stamp of the last released message, by stream."""
        self.released_ns: int | None = None
        self._window_ns, self._punctual, self._drops = window_ns, punctual, drops
        self._recent_ns: dict[int, deque[int]] = {}
        self._complete_ns: dict[int, int] = {}
        self._all_complete_ns: int | None = None
        self._buffer: list[tuple[int, int, int, T]] = []
        self._arrivals = 0

    def add(self, t_ns: int, stream: int, item: T, arrival_ns: int, *, leads: bool = True) -> Sequence[T]:
        """Add one message and return those that are due; one that does not lead is no sign of time."""
        self._arrivals += 1
        is_before_released = self.released_ns is not None and t_ns < self.released_ns
        if is_before_released and self._punctual and stream not in self._punctual:
            return self._add_late(t_ns, stream, item)
        if len(self._buffer) >= MAX_BUFFERED:
            self._drops[Drop.OUTLIER, stream] += 1
            return ()
        self._buffer.append((t_ns, stream, self._arrivals, item))
        if leads and t_ns > self.newest_ns:
            self.newest_ns, self.newest_arrival_ns = t_ns, arrival_ns
        complete_ns = self._advance_completeness(t_ns, stream) if stream in self._punctual else None
        if complete_ns is None and self.newest_ns < self._next_release_ns:
            return ()
        self._next_release_ns = (
            self.newest_ns + self._window_ns // 4
        )  # sorting a few hundred at once is cheap
        until_ns = self.newest_ns - self._window_ns
        return self.release(until_ns if complete_ns is None else max(until_ns, complete_ns))

    def _advance_completeness(self, t_ns: int, stream: int) -> int | None:
        """Return the time up to which all punctual streams are complete; None if it has not advanced.

        The next message of a stream is not expected before half of its shortest recent interval has passed.
        """
        recent_ns = self._recent_ns.setdefault(stream, deque(maxlen=RECENT_INTERVALS + 1))
        if recent_ns and t_ns <= recent_ns[-1]:
            return None
        recent_ns.append(t_ns)
        shortest_ns = min((b - a for a, b in pairwise(recent_ns)), default=0)
        self._complete_ns[stream] = t_ns + shortest_ns // 2
        complete_ns, before_ns = min(self._complete_ns.values()), self._all_complete_ns
        if len(self._complete_ns) < len(self._punctual):
            return None
        if before_ns is not None and complete_ns <= before_ns:
            return None
        self._all_complete_ns = complete_ns
        return complete_ns

    def release(self, until_ns: int | None = None) -> Sequence[T]:
        """Return all messages up to a time, or all, sorted."""
        self._buffer.sort()
        end = len(self._buffer)
        if until_ns is not None:
            end = bisect_right(self._buffer, until_ns, key=lambda buffered: buffered[0])
        due, self._buffer = self._buffer[:end], self._buffer[end:]
        items = []
        for t_ns, stream, _, item in due:
            if self.released_ns is not None and t_ns < self.released_ns:
                self._drops[Drop.LATE, stream] += 1
            elif self.last_of.get(stream) == t_ns:
                self._drops[Drop.DUPLICATE, stream] += 1
            else:
                self.last_of[stream] = self.released_ns = t_ns
                items.append(item)
        return items

    def _add_late(self, t_ns: int, stream: int, item: T) -> Sequence[T]:
        """Release a late message of a stream that is not punctual: unsorted, but in order in its stream."""
        if t_ns < max(self.newest_ns - self._window_ns, self.last_of.get(stream, t_ns - 1) + 1):
            self._drops[Drop.LATE, stream] += 1
            return ()
        self.last_of[stream] = t_ns
        return (item,)

    def discard(self) -> None:
        """Drop the buffered messages: they were outliers, not a time base."""
        self._drops.update((Drop.OUTLIER, stream) for _, stream, _, _ in self._buffer)


class Reorderer(Generic[T]):
    """Sorts messages by stamp and inserts a `ClockStep` where the clock of the stamps steps.

    Messages newer than the newest stamp less the window are buffered, so that a message that is late by
    less than the window is sorted in. Messages with equal stamps are released in the order of their
    streams. A message whose stamp differs from the newest by more than `step_ns`, or with known times of
    arrival is earlier by more than the window, is an outlier and is kept aside. If the stamps continue from
    there, and no longer from the old time base, the clock has stepped: a `ClockStep` precedes the first
    message of the new time base. Otherwise the outlier is dropped.

    With the window alone, a live robot would always lag by the whole window. Messages that precede the next
    message of every `punctual` stream are therefore released at once, because punctual streams arrive in
    order and at regular intervals; the window only matters when one of them stops. The other streams may be
    late within the window: their messages are then released out of order, but in order within their stream.

    If the time of arrival by a steady clock is known, stamps may advance with it: a pause of all sensors is
    no step, and a jump much shorter than such a pause is detected.
    """

    def __init__(
        self, window_ns: int, step_ns: int, punctual: Collection[int] = (), followers: Collection[int] = ()
    ) -> None:
        """Start with an empty buffer.

        Args:
            window_ns: maximum delay of a message.
            step_ns: threshold above which a jump of the stamps is a step of the clock; with known times of
                arrival, a jump back beyond the window is one.
            punctual: streams whose messages arrive in the order of their stamps.
            followers: streams whose stamps are no sign of time, so that a wrong clock of theirs cannot make
                the messages of the others late.
        """
        self.drops: Drops = Counter()
        self._window_ns, self._step_ns, self._punctual = window_ns, step_ns, frozenset(punctual)
        self._followers = frozenset(followers)
        self._base: _TimeBase[T] | None = None
        self._outliers: list[tuple[int, int, T, int]] = []
        self._newest_at_outlier_ns = 0
        self._last_pushed: dict[int, int] = {}

    def push(self, t_ns: int, stream: int, item: T, arrival_ns: int = 0) -> Sequence[T | ClockStep]:
        """Add one message and return those that are due.

        Args:
            t_ns: stamp of the message.
            stream: number of its topic.
            item: object to release in its place.
            arrival_ns: time of arrival by a clock that never steps; 0 if unknown.
        """
        if self._last_pushed.get(stream) == t_ns:
            self.drops[Drop.DUPLICATE, stream] += 1
            return ()
        self._last_pushed[stream] = t_ns
        leads = stream not in self._followers
        if self._base is None:
            if not leads:
                return ()
            self._base = self._new_base(t_ns, arrival_ns)
        if self._outliers and self._base.newest_ns - self._newest_at_outlier_ns > CONFIRMATION_NS // 2:
            self._drop_outliers()
        elapsed_ns = max(arrival_ns - self._base.newest_arrival_ns, 0)
        ahead_ns = t_ns - self._base.newest_ns
        back_ns = min(self._window_ns, self._step_ns) if arrival_ns else self._step_ns
        is_in_range = -back_ns <= ahead_ns <= self._step_ns + elapsed_ns
        if is_in_range and not self._continues_outliers(t_ns, ahead_ns):
            if ahead_ns > 0 and self._outliers and self._is_late(self._outliers[0][0]):
                self._drop_outliers()
            return self._base.add(t_ns, stream, item, arrival_ns, leads=leads)
        if not leads and not self._outliers:
            self.drops[Drop.OUTLIER, stream] += 1
            return ()
        return self._add_outlier(self._base, t_ns, stream, item, arrival_ns)

    def finish(self) -> Sequence[T | ClockStep]:
        """Return the messages that are still buffered, after the last message."""
        self._drop_outliers()
        return self._base.release() if self._base else ()

    def _continues_outliers(self, t_ns: int, ahead_ns: int) -> bool:
        """Return True if a stamp is nearer to the last outlier than to the newest stamp.

        After a step back, the new stamps soon reach the range of the old ones.
        """
        return bool(self._outliers) and abs(t_ns - self._outliers[-1][0]) < abs(ahead_ns)

    def _add_outlier(
        self, base: _TimeBase[T], t_ns: int, stream: int, item: T, arrival_ns: int
    ) -> Sequence[T | ClockStep]:
        """Keep an outlier; return the messages to release if it confirms a step of the clock."""
        if self._outliers:
            is_apart = abs(t_ns - self._outliers[-1][0]) > self._step_ns
            if is_apart or len(self._outliers) >= MAX_BUFFERED:
                self._drop_outliers()
        if not self._outliers:
            self._newest_at_outlier_ns = base.newest_ns
        self._outliers.append((t_ns, stream, item, arrival_ns))
        first_ns, _, _, first_arrival_ns = self._outliers[0]
        lasted_ns = t_ns - first_ns
        has_lasted = not arrival_ns or arrival_ns - first_arrival_ns >= CONFIRMATION_NS // 2
        is_confirmed = lasted_ns >= CONFIRMATION_NS and has_lasted and not self._is_one_late_stream()
        return self._step(base) if is_confirmed or lasted_ns >= UNDENIABLE_NS else ()

    def _step(self, base: _TimeBase[T]) -> Sequence[T | ClockStep]:
        """Start a new time base with the outliers."""
        first_ns, arrival_ns = min((t_ns, arrival_ns) for t_ns, _, _, arrival_ns in self._outliers)
        items: list[T | ClockStep] = []
        if base.released_ns is None and base.newest_ns - base.first_ns < CONFIRMATION_NS:
            base.discard()
        else:
            items += base.release(base.newest_ns)
            elapsed_ns = max(arrival_ns - base.newest_arrival_ns, 0)
            items.append(ClockStep(first_ns, first_ns - base.newest_ns - elapsed_ns))
        outliers, self._outliers = self._outliers, []
        self._base = self._new_base(first_ns, arrival_ns)
        for t_ns, stream, item, arrival_ns in outliers:
            leads = stream not in self._followers
            items += self._base.add(t_ns, stream, item, arrival_ns, leads=leads)
        return items

    def _new_base(self, first_ns: int, arrival_ns: int) -> _TimeBase[T]:
        return _TimeBase(first_ns, arrival_ns, self._window_ns, self._punctual, self.drops)

    def _drop_outliers(self) -> None:
        for t_ns, stream, _, _ in self._outliers:
            self.drops[Drop.LATE if self._is_late(t_ns) else Drop.OUTLIER, stream] += 1
        self._outliers = []

    def _is_one_late_stream(self) -> bool:
        """Return True if the outliers are of one of several streams, which may have outlasted the others."""
        streams = {stream for _, stream, _, _ in self._outliers}
        is_one = len(streams) == 1 and len(self._last_pushed.keys() - self._followers) > 1
        return is_one and self._is_late(self._outliers[0][0])

    def _is_late(self, t_ns: int) -> bool:
        """Return True for an outlier that is only late, unless all other messages are as well."""
        return -self._step_ns <= t_ns - self._newest_at_outlier_ns < 0
