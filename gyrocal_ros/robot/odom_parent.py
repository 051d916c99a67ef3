"""Whether somebody else says where odom lies: a frame has one parent, and two would fight (REP 105)."""

from __future__ import annotations

from collections import deque

LISTENING_S = 2.0
"""So long is listened before anything is said."""
HELD_BACK_S = 10.0
"""Who has not spoken for so long has stopped."""


class OdomParentGuard:
    """Listens to the transforms of others and tells whether ours may be sent.

    Args:
        now_s: the time by a clock that is never set, as everywhere here.
    """

    def __init__(self, now_s: float) -> None:
        self._start_s = now_s
        self._own: deque[tuple[str, int]] = deque(maxlen=500)
        self._other = ''
        self._other_s = -HELD_BACK_S

    def sent(self, parent: str, t_ns: int) -> None:
        """Note that we have sent where odom lies."""
        self._own.append((parent, t_ns))

    def heard(self, parent: str, t_ns: int, now_s: float, *, is_static: bool = False) -> None:
        """Note that a transform with odom as its child has come, perhaps our own."""
        if (parent, t_ns) not in self._own:
            self._other, self._other_s = parent, float('inf') if is_static else now_s

    def may_send(self, now_s: float) -> bool:
        """Whether odom has no other parent."""
        return now_s - self._start_s >= LISTENING_S and now_s - self._other_s >= HELD_BACK_S

    def complaint(self, now_s: float) -> str:
        """What is in the way, empty for nothing."""
        if now_s - self._other_s >= HELD_BACK_S:
            return ''
        return (
            f'somebody else publishes the transform from {self._other} to odom, so map to odom is held back; '
            'stop that, or set live.publish_map_transform to false'
        )
