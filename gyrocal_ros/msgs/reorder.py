"""Sorts messages by their stamps with a bounded memory, and sees when the clock of the stamps jumps."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Collection, Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Generic, TypeAlias, TypeVar

from gyrocal_ros.data import NS_PER_S, ClockStep

T = TypeVar('T')

LASTING_NS = NS_PER_S // 2
"""Stamps that have run on from a jump for so long were no slip, unless they came in half the time: then
they have waited somewhere."""
INTERVALS = 5
"""The shortest of so many last intervals of a stream tells when its next message is due."""
MAX_HELD = 300_000
"""So many messages are held back at most, where a broken clock stands still."""


class Drop(StrEnum):
    """Why a message was left out."""

    LATE = 'late'
    """Newer ones had been handed on already."""
    DUPLICATE = 'duplicate'
    """Its stream had this stamp before."""
    ODD = 'odd_stamp'
    """Its stamp lies far from those before and after it."""


Drops: TypeAlias = Counter[tuple[Drop, int]]
"""How many messages of which stream were left out, and why."""


class _TimeBase(Generic[T]):
    """The messages of one clock, sorted within a window."""

    def __init__(
        self, first_ns: int, arrival_ns: int, window_ns: int, punctual: frozenset[int], drops: Drops
    ) -> None:
        self.first_ns = self.newest_ns = self._due_ns = first_ns
        self.newest_arrival_ns = arrival_ns
        self.last_of: dict[int, int] = {}
        """Stamp of the last message handed on, by stream."""
        self.handed_on_ns: int | None = None
        self._window_ns, self._punctual, self._drops = window_ns, punctual, drops
        self._came_ns: dict[int, deque[int]] = {}
        self._reached_ns: dict[int, int] = {}
        self._all_reached_ns: int | None = None
        self._held: list[tuple[int, int, int, T]] = []
        self._arrivals = 0

    def add(self, t_ns: int, stream: int, item: T, arrival_ns: int) -> Sequence[T]:
        """Take one message and return those that are due."""
        self._arrivals += 1
        was_handed_on = self.handed_on_ns is not None and t_ns < self.handed_on_ns
        if was_handed_on and self._punctual and stream not in self._punctual:
            return self._add_late(t_ns, stream, item)
        if len(self._held) >= MAX_HELD:
            self._drops[Drop.ODD, stream] += 1
            return ()
        self._held.append((t_ns, stream, self._arrivals, item))
        if t_ns > self.newest_ns:
            self.newest_ns, self.newest_arrival_ns = t_ns, arrival_ns
        reached_ns = self._all_have_reached(t_ns, stream) if stream in self._punctual else None
        if reached_ns is None and self.newest_ns < self._due_ns:
            return ()
        self._due_ns = self.newest_ns + self._window_ns // 4  # sorting a few hundred at once is cheap
        until_ns = self.newest_ns - self._window_ns
        return self.hand_on(until_ns if reached_ns is None else max(until_ns, reached_ns))

    def _all_have_reached(self, t_ns: int, stream: int) -> int | None:
        """Up to when nothing more will come of the punctual streams; None where that is not news.

        The next message of a stream does not come before half an interval has passed.
        """
        came_ns = self._came_ns.setdefault(stream, deque(maxlen=INTERVALS + 1))
        if came_ns and t_ns <= came_ns[-1]:
            return None
        came_ns.append(t_ns)
        shortest_ns = min((b - a for a, b in pairwise(came_ns)), default=0)
        self._reached_ns[stream] = t_ns + shortest_ns // 2
        reached_ns, before_ns = min(self._reached_ns.values()), self._all_reached_ns
        if len(self._reached_ns) < len(self._punctual) or (before_ns is not None and reached_ns <= before_ns):
            return None
        self._all_reached_ns = reached_ns
        return reached_ns

    def hand_on(self, until_ns: int) -> Sequence[T]:
        """Return all messages up to a time, sorted."""
        self._held.sort()
        end = bisect_right(self._held, until_ns, key=lambda held: held[0])
        due, self._held = self._held[:end], self._held[end:]
        items = []
        for t_ns, stream, _, item in due:
            if self.handed_on_ns is not None and t_ns < self.handed_on_ns:
                self._drops[Drop.LATE, stream] += 1
            elif self.last_of.get(stream) == t_ns:
                self._drops[Drop.DUPLICATE, stream] += 1
            else:
                self.last_of[stream] = self.handed_on_ns = t_ns
                items.append(item)
        return items

    def _add_late(self, t_ns: int, stream: int, item: T) -> Sequence[T]:
        """Take a message for which nobody waited: it comes out of order, but not of that of its stream."""
        if t_ns < max(self.newest_ns - self._window_ns, self.last_of.get(stream, t_ns - 1) + 1):
            self._drops[Drop.LATE, stream] += 1
            return ()
        self.last_of[stream] = t_ns
        return (item,)

    def discard(self) -> None:
        """Drop what is held back: this was no clock but a slip."""
        self._drops.update((Drop.ODD, stream) for _, stream, _, _ in self._held)


class Reorderer(Generic[T]):
    """Takes messages as they were recorded and hands them on in the order of their stamps.

    What is newer than the newest stamp less the window is held back, so that whatever comes less
    late than that is sorted in; messages of equal stamp come out in the order of their streams. A
    message whose stamp lies further than `step_ns` from the newest is set aside. When stamps go on
    from there, and no longer from where they were, the clock has stepped: a `ClockStep` then stands
    in the output before the first message of the new time base. Else it was a slip and is dropped.

    A robot that waits for the whole window is always late. What comes before the next message of each
    of the `punctual` streams is handed on at once, for these come in their order and about evenly; the
    window then is but for one that falls silent. Other streams may come later, within the window: their
    messages are handed on out of order, but in that of their stream.

    Where the time of arrival by a steady clock is known, stamps may run on with it: a pause of all
    sensors is no step, and a jump that is much shorter than such a pause shows.
    """

    def __init__(self, window_ns: int, step_ns: int, punctual: Collection[int] = ()) -> None:
        """Start empty.

        Args:
            window_ns: how late a message may come.
            step_ns: how large a jump of the stamps makes a step of the clock.
            punctual: streams whose messages come in the order of their stamps.
        """
        self.drops: Drops = Counter()
        self._window_ns, self._step_ns, self._punctual = window_ns, step_ns, frozenset(punctual)
        self._base: _TimeBase[T] | None = None
        self._aside: list[tuple[int, int, T, int]] = []
        self._newest_then_ns = 0
        self._last_pushed: dict[int, int] = {}

    def push(self, t_ns: int, stream: int, item: T, arrival_ns: int = 0) -> Sequence[T | ClockStep]:
        """Take one message and return those that are due.

        Args:
            t_ns: its stamp.
            stream: number of the topic that it belongs to.
            item: what to hand on.
            arrival_ns: when it came, by a clock that never steps; 0 where nobody knows.
        """
        if self._last_pushed.get(stream) == t_ns:
            self.drops[Drop.DUPLICATE, stream] += 1
            return ()
        self._last_pushed[stream] = t_ns
        if self._base is None:
            self._base = self._new_base(t_ns, arrival_ns)
        if self._aside and self._base.newest_ns - self._newest_then_ns > LASTING_NS // 2:
            self._drop_aside()
        passed_ns = arrival_ns - self._base.newest_arrival_ns
        newer_ns = t_ns - self._base.newest_ns
        if -self._step_ns <= newer_ns <= self._step_ns + passed_ns and not self._runs_aside(t_ns, newer_ns):
            return self._base.add(t_ns, stream, item, arrival_ns)
        return self._set_aside(self._base, t_ns, stream, item, arrival_ns)

    def finish(self) -> Sequence[T | ClockStep]:
        """Return what is still held back, after the last message."""
        self._drop_aside()
        return self._base.hand_on(self._base.newest_ns) if self._base else ()

    def _runs_aside(self, t_ns: int, newer_ns: int) -> bool:
        """Whether a stamp goes on from those aside: after a step back they soon come near the old ones."""
        return bool(self._aside) and abs(t_ns - self._aside[-1][0]) < abs(newer_ns)

    def _set_aside(
        self, base: _TimeBase[T], t_ns: int, stream: int, item: T, arrival_ns: int
    ) -> Sequence[T | ClockStep]:
        if self._aside:
            apart = abs(t_ns - self._aside[-1][0]) > self._step_ns
            if apart or len(self._aside) >= MAX_HELD:
                self._drop_aside()
        if not self._aside:
            self._newest_then_ns = base.newest_ns
        self._aside.append((t_ns, stream, item, arrival_ns))
        first_ns, _, _, first_arrival_ns = self._aside[0]
        has_lasted = not arrival_ns or arrival_ns - first_arrival_ns >= LASTING_NS // 2
        return self._step(base) if t_ns - first_ns >= LASTING_NS and has_lasted else ()

    def _step(self, base: _TimeBase[T]) -> Sequence[T | ClockStep]:
        """Begin a new time base with the messages set aside."""
        first_ns, arrival_ns = min((t_ns, arrival_ns) for t_ns, _, _, arrival_ns in self._aside)
        items: list[T | ClockStep] = []
        if base.handed_on_ns is None and base.newest_ns - base.first_ns < LASTING_NS:
            base.discard()
        else:
            items += base.hand_on(base.newest_ns)
            passed_ns = arrival_ns - base.newest_arrival_ns
            items.append(ClockStep(first_ns, first_ns - base.newest_ns - passed_ns))
        aside, self._aside = self._aside, []
        self._base = self._new_base(first_ns, arrival_ns)
        for t_ns, stream, item, arrival_ns in aside:
            items += self._base.add(t_ns, stream, item, arrival_ns)
        return items

    def _new_base(self, first_ns: int, arrival_ns: int) -> _TimeBase[T]:
        return _TimeBase(first_ns, arrival_ns, self._window_ns, self._punctual, self.drops)

    def _drop_aside(self) -> None:
        self.drops.update((Drop.ODD, stream) for _, stream, _, _ in self._aside)
        self._aside = []
