"""Pace of a playback: no faster than its listener answers, so that a busy computer loses no messages."""

from __future__ import annotations

MAX_UNANSWERED = 100
"""Number of messages sent ahead of the answers; the queues of the listeners hold more."""
PATIENCE_S = 3.0
"""Time without an answer after which messages count as lost, and the playback continues."""


class Pacing:
    """Counts messages of one kind and the answers of a listener to each of them.

    Before the first answer the listener may not be ready, so nothing is counted.

    Args:
        limit: number of unanswered messages from which the playback waits.
        patience_s: time without an answer for which it waits.
    """

    def __init__(self, limit: int = MAX_UNANSWERED, patience_s: float = PATIENCE_S) -> None:
        self.sent = self.lost = 0
        """Number of messages since the first answer, and of those that were never answered."""
        self._limit, self._patience_s = limit, patience_s
        self._unanswered, self._answered_s = 0, float('inf')
        self._has_begun = False

    def add_sent(self) -> None:
        """Count a message."""
        if self._has_begun:
            self.sent += 1
            self._unanswered += 1

    def add_answer(self, now_s: float) -> None:
        """Count an answer, at a time by a monotonic clock."""
        self._has_begun, self._answered_s = True, now_s
        self._unanswered = max(self._unanswered - 1, 0)

    def may_send(self, now_s: float) -> bool:
        """Return True if the listener keeps up, or has not answered for too long."""
        if self._unanswered < self._limit:
            return True
        if self.is_waiting(now_s):
            return False
        self.finish()
        return True

    def is_waiting(self, now_s: float) -> bool:
        """Return True if an answer may still come."""
        return self._unanswered > 0 and now_s - self._answered_s < self._patience_s

    def finish(self) -> None:
        """Count the messages without an answer as lost."""
        self.lost += self._unanswered
        self._unanswered = 0
