"""Which problems of a status are logged now: each at once, and again at intervals while it lasts."""

from __future__ import annotations

import re
from collections.abc import Iterator

from gyrocal_ros.robot.health import Problem, Status

REPEAT_S = 60.0
"""Interval at which a problem that lasts, or comes again, is logged."""
NUMBER = re.compile(r'[-+]?\d[\d.e+-]*')


class ProblemLog:
    """Throttles problems; texts that differ only by numbers are one problem."""

    def __init__(self) -> None:
        self._logged_s: dict[str, float] = {}

    def due(self, status: Status, now_s: float) -> Iterator[Problem]:
        """Yield the problems to log now.

        Args:
            status: the present status.
            now_s: the present time, by a monotonic clock.
        """
        self._logged_s = {key: at_s for key, at_s in self._logged_s.items() if now_s - at_s < REPEAT_S}
        for problem in status.problems:
            key = f'{problem.level} {NUMBER.sub("#", problem.text)}'
            if key not in self._logged_s:
                self._logged_s[key] = now_s
                yield problem
