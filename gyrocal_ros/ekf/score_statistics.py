"""What the innovations say of effects that the model lacks, kept per stretch of time.

With nu(theta) = nu(0) - G theta, the sums Lambda = sum G^T S^-1 G and b = sum G^T S^-1 nu are all
that is needed: estimate, significance and likelihood gain of every set of candidates follow (the
generalised likelihood ratio of Willsky and Jones 1976). Kept by blocks of time they also tell how
honest the filter's own S is, and what was learned on one stretch can be tried on another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.ekf.update import UpdateStats
from gyrocal_ros.model.sensor import Effect

BLOCK_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class ScoreStatistics:
    """Sums over B blocks of time for c candidate coefficients."""

    candidates: tuple[Effect, ...]
    start_s: Array
    """(B,) since the first step."""
    information: Array
    """(B, c, c) Lambda of each block."""
    score: Array
    """(B, c) b of each block."""

    def first_half(self) -> ScoreStatistics:
        """That of the first half of the blocks."""
        half = (len(self.start_s) + 1) // 2
        return ScoreStatistics(
            self.candidates, self.start_s[:half], self.information[:half], self.score[:half]
        )


class ScoreRecorder:
    """Adds up lessons, block by block."""

    def __init__(self, candidates: tuple[Effect, ...]) -> None:
        self._candidates = candidates
        self._count = sum(len(effect.coefficients) for effect in candidates)
        self._information: list[Array] = []
        self._score: list[Array] = []

    def add(self, time_ns: int, lessons: tuple[UpdateStats, ...]) -> None:
        """Take in what one step of the filter taught, so long after the first one."""
        block = int(time_ns / (BLOCK_S * NS_PER_S))
        while len(self._score) <= block:
            self._information.append(np.zeros((self._count, self._count)))
            self._score.append(np.zeros(self._count))
        for lesson in lessons:
            if lesson.information is not None and lesson.score is not None:
                self._information[block] += lesson.information
                self._score[block] += lesson.score

    def scores(self) -> ScoreStatistics:
        """All so far."""
        start_s = BLOCK_S * np.arange(len(self._score))
        return ScoreStatistics(self._candidates, start_s, np.array(self._information), np.array(self._score))
