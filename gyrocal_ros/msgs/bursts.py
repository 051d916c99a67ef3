"""Samples that share a stamp, as of a driver that reads the buffer of an IMU and stamps all of it at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gyrocal_ros.data import NS_PER_S, ImuSample

MANY = 20
"""Number of samples with the stamp of the one before, from which a driver stamps bursts."""
LONGEST_NS = NS_PER_S // 5
"""Longest time between the stamps of two bursts that follow each other."""


class Bursts:
    """Spreads the samples of each burst over the time since the burst before.

    Nothing is held back, and repeated stamps stay, until many have been seen. Then a burst is due when the
    next one begins.
    """

    def __init__(self) -> None:
        self._held: list[ImuSample] = []
        self._before_ns = 0
        self._repeated = 0

    def add(self, sample: ImuSample) -> Sequence[ImuSample]:
        """Take a sample; return those that are due, each with a stamp of its own."""
        if self._held and sample.t_ns == self._held[0].t_ns:
            self._repeated += sample != self._held[-1]  # otherwise each may be sent twice
            self._held.append(sample)
            return () if self._repeated > MANY else (sample,)
        due = self._spread() if self._repeated > MANY else (sample,)
        self._before_ns = self._held[0].t_ns if self._held else 0
        self._held = [sample]
        return due

    def _spread(self) -> Sequence[ImuSample]:
        """Return the samples of the last burst; only its last one where none has come just before."""
        end_ns, count = self._held[0].t_ns, len(self._held)
        time_ns = end_ns - self._before_ns
        if not 0 < time_ns <= LONGEST_NS:
            return self._held[-1:]
        return [
            replace(sample, t_ns=end_ns - time_ns * (count - 1 - place) // count)
            for place, sample in enumerate(self._held)
        ]
