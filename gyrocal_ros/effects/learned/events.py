"""Events of a recorded signal: it rises above a value, or falls below it, as where something is switched."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.effects.learned.signals import values_of
from gyrocal_ros.model.sensor import Memory

LASTING_S = 1.0
"""Time for which a signal is on the other side before an event, so that noise about the value is none."""
MIN_SIDE_S = 5.0
"""Least time in all on either side of the value of a signal that has events."""
MIN_EVENTS = 2
"""Number of events from which something may follow them: after a single one, anything may have changed."""
PARTS = (0.5, 0.25, 0.75)
"""Values that are tried, as parts of the range of a signal, the likeliest first."""
_NAME = re.compile(r'(above|below)_(-?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?):(.+)')


@dataclass(frozen=True, slots=True)
class Event:
    """That a signal passes a value."""

    signal: str
    value: float
    rises: bool

    @property
    def drive(self) -> str:
        """Name of the event as the drive of a memory, `above_0.5:brush.speed`."""
        return f'{self.kind}_{self.value:g}:{self.signal}'

    @property
    def kind(self) -> str:
        """The side on which the signal then is."""
        return 'above' if self.rises else 'below'

    @property
    def in_words(self) -> str:
        """What happens, as a noun."""
        return f'a {"rise" if self.rises else "fall"} of {self.signal} past {self.value:g}'

    def is_on(self, values: Array) -> np.ndarray:
        """Return True (n,) where a signal (n,) is beyond the value; not where it is not recorded."""
        on: np.ndarray = values > self.value if self.rises else values < self.value
        return on


@cache
def event_of(drive: str) -> Event | None:
    """Return the event that is the drive of a memory; None where it is none."""
    named = _NAME.fullmatch(drive)
    return None if named is None else Event(named[3], float(named[2]), named[1] == 'above')


def since_event(drive: str, block: MotionBlock, memory: Memory) -> tuple[Array, Array, Memory]:
    """Return 1 (N,) after the first event, else 0, and the time (N,) since the last one, 0 before the first.

    The side on which the recording begins is no event. The memory comes third.
    """
    event = event_of(drive)
    assert event is not None
    off_s, elapsed_s = memory if memory is not None else (0.0, math.inf)
    on, times_s = event.is_on(values_of(event.signal, block)), np.empty(len(block.dt_s))
    for row, (is_on, dt_s) in enumerate(zip(on.tolist(), block.dt_s.tolist(), strict=True)):
        elapsed_s = 0.0 if is_on and off_s >= LASTING_S else elapsed_s + dt_s
        off_s = 0.0 if is_on else off_s + dt_s
        times_s[row] = elapsed_s
    has_been = np.isfinite(times_s)
    return has_been.astype(float), np.where(has_been, times_s, 0.0), (off_s, elapsed_s)


def events_in(signal: str, low: float, high: float) -> tuple[Event, ...]:
    """Return the events that a signal with this range may have: rises and falls past a few values."""
    values = [float(f'{low + part * (high - low):.4g}') for part in PARTS]
    return tuple(Event(signal, value, rises) for rises in (True, False) for value in values)


def count_events(event: Event, values: Array, dt_s: Array) -> int:
    """Return how often an event happens; 0 where one side of the value hardly occurs.

    Args:
        event: the event.
        values: (n,) the signal, NaN where it is not recorded.
        dt_s: (n,) time for which it has each value.
    """
    known = np.isfinite(values)
    on, ends_s = event.is_on(values[known]), np.cumsum(dt_s[known])
    if min(dt_s[known][on].sum(), dt_s[known][~on].sum()) < MIN_SIDE_S:
        return 0
    begins = np.flatnonzero(np.diff(on.astype(int)) == 1) + 1
    off_since_s = np.maximum.accumulate(np.where(on, ends_s, 0.0))[begins - 1]
    return int(np.count_nonzero(ends_s[begins - 1] - off_since_s >= LASTING_S))
