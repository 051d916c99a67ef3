"""Sorts messages by their stamps with a bounded memory, and sees when the clock of the stamps jumps."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from typing import Generic, TypeAlias, TypeVar

from gyrocal_ros.data import NS_PER_S, ClockStep

T = TypeVar('T')

LASTING_NS = NS_PER_S // 2
"""Stamps that have run on from a jump for so long were no slip."""
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

    def __init__(self, first_ns: int, arrival_ns: int, window_ns: int, drops: Drops) -> None:
        self.first_ns = self.newest_ns = self._due_ns = first_ns
        self.newest_arrival_ns = arrival_ns
        self.last_of: dict[int, int] = {}
        """Stamp of the last message handed on, by stream."""
        self.handed_on_ns: int | None = None
        self._window_ns, self._drops = window_ns, drops
        self._held: list[tuple[int, int, int, T]] = []
        self._arrivals = 0

    def add(self, t_ns: int, stream: int, item: T, arrival_ns: int) -> Sequence[T]:
        """Take one message and return those that are due."""
        self._arrivals += 1
        if len(self._held) >= MAX_HELD:
            self._drops[Drop.ODD, stream] += 1
            return ()
        self._held.append((t_ns, stream, self._arrivals, item))
        if t_ns > self.newest_ns:
            self.newest_ns, self.newest_arrival_ns = t_ns, arrival_ns
        if self.newest_ns < self._due_ns:
            return ()
        self._due_ns = self.newest_ns + self._window_ns // 4  # sorting a few hundred at once is cheap
        return self.hand_on(self.newest_ns - self._window_ns)

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

    Where the time of arrival by a steady clock is known, stamps may run on with it: a pause of all
    sensors is no step, and a jump that is much shorter than such a pause shows.
    """

    def __init__(self, window_ns: int, step_ns: int) -> None:
        """Start empty.

        Args:
            window_ns: how late a message may come.
            step_ns: how large a jump of the stamps makes a step of the clock.
        """
        self.drops: Drops = Counter()
        self._window_ns, self._step_ns = window_ns, step_ns
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
            arrival_ns: when it came, by a clock that never steps; always the same where nobody knows.
        """
        if self._last_pushed.get(stream) == t_ns:
            self.drops[Drop.DUPLICATE, stream] += 1
            return ()
        self._last_pushed[stream] = t_ns
        if self._base is None:
            self._base = _TimeBase(t_ns, arrival_ns, self._window_ns, self.drops)
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
        return self._step(base) if t_ns - self._aside[0][0] >= LASTING_NS else ()

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
        self._base = _TimeBase(first_ns, arrival_ns, self._window_ns, self.drops)
        for t_ns, stream, item, arrival_ns in aside:
            items += self._base.add(t_ns, stream, item, arrival_ns)
        return items

    def _drop_aside(self) -> None:
        self.drops.update((Drop.ODD, stream) for _, stream, _, _ in self._aside)
        self._aside = []
