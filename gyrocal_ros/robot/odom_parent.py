"""Detects another publisher of odom's parent: a TF frame has only one (REP 105)."""

from __future__ import annotations

from collections import deque

LISTEN_S = 2.0
"""Time after the start in which nothing is sent, to receive the transforms of others first."""
OTHER_TIMEOUT_S = 10.0
"""Time since the last transform of another publisher after which that counts as stopped."""


class OdomParentGuard:
    """Decides by the transforms of others whether map to odom may be sent.

    Args:
        now_s: the present time, by a monotonic clock.
    """

    def __init__(self, now_s: float) -> None:
        self._start_s = now_s
        self._own: deque[tuple[str, int]] = deque(maxlen=500)
        self._other_parent = ''
        self._other_s = -OTHER_TIMEOUT_S

    def add_own(self, parent: str, t_ns: int) -> None:
        """Store a transform to odom that this node has sent."""
        self._own.append((parent, t_ns))

    def add_received(self, parent: str, t_ns: int, now_s: float, *, is_static: bool = False) -> None:
        """Take in a received transform to odom, which may be an own one."""
        if (parent, t_ns) not in self._own:
            self._other_parent, self._other_s = parent, float('inf') if is_static else now_s

    def may_send(self, now_s: float) -> bool:
        """Return True if odom has no other parent."""
        return now_s - self._start_s >= LISTEN_S and now_s - self._other_s >= OTHER_TIMEOUT_S

    def problem(self, now_s: float) -> str:
        """Return why map to odom is not sent; empty where no other publisher prevents it."""
        if now_s - self._other_s >= OTHER_TIMEOUT_S:
            return ''
        return (
            f'another node publishes the transform from {self._other_parent} to odom, so map to odom is not '
            'published; stop that node, or set live.publish_map_transform to false'
        )
