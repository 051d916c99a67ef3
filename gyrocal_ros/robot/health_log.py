"""What comes and what happens at a running part of the robot, and how much of it of late."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping

from gyrocal_ros.msgs.topics import Role

RECENT_S = 10.0
"""What happened is told for so long."""
MAX_EVENTS = 20


class HealthLog:
    """Keeps what a judgement of the present moment is made of.

    Args:
        silent_s: by topic, what says nothing for so long is missed.
        start_s: now, by a clock that is never set, as everywhere here.
    """

    def __init__(self, silent_s: Mapping[Role, float], start_s: float) -> None:
        self._silent_s, self._start_s = silent_s, start_s
        self._last_s: dict[str, float] = {}
        self._events: deque[tuple[float, str]] = deque(maxlen=MAX_EVENTS)
        self._tallies: deque[tuple[float, Counter[str]]] = deque([(start_s, Counter())])

    def hear(self, topic: str, now_s: float) -> None:
        """Note that a message has come."""
        self._last_s[topic] = now_s

    def happened(self, text: str, now_s: float) -> None:
        """Note what a person should know for a while."""
        self._events.append((now_s, text))

    def running_s(self, now_s: float) -> float:
        """Since the start."""
        return now_s - self._start_s

    def silence(self, topic: Role, now_s: float) -> str:
        """`nothing for 5 s`, or nothing at all where it speaks."""
        last_s = self._last_s.get(topic)
        silent_s = now_s - (self._start_s if last_s is None else last_s)
        if silent_s < self._silent_s[topic]:
            return ''
        return 'nothing has come yet' if last_s is None else f'nothing for {silent_s:.0f} s'

    def events(self, now_s: float) -> list[str]:
        """What happened of late, each once."""
        return list(dict.fromkeys(text for when_s, text in self._events if now_s - when_s <= RECENT_S))

    def recent(self, counts: Counter[str], now_s: float) -> tuple[Counter[str], float]:
        """Take down all counts up to now; return what was counted of late, and over how long (s).

        To be asked once a second or so.
        """
        while len(self._tallies) > 1 and self._tallies[1][0] <= now_s - RECENT_S:
            self._tallies.popleft()
        before_s, before = self._tallies[0]
        self._tallies.append((now_s, counts.copy()))
        return counts - before, max(now_s - before_s, 1e-3)
