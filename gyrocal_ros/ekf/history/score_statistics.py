"""Score statistics of candidate effects, accumulated per 10 s block.

With nu(theta) = nu(0) - G theta, the sums Lambda = sum G^T S^-1 G and b = sum G^T S^-1 nu are
sufficient: estimate, significance and likelihood gain of every set of candidates follow (the generalised
likelihood ratio of Willsky and Jones 1976). By blocks of time they also show whether the filter's own S is
right, and a fit to some blocks can be tested on others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array, IntArray
from gyrocal_ros.ekf.equations.feature_scores import FeatureScatter, FeatureScatterRecorder, FeatureScores
from gyrocal_ros.ekf.equations.update import UpdateStats
from gyrocal_ros.model.sensor import Effect

BLOCK_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class ScoreStatistics:
    """Sums over B blocks of time for c candidate coefficients."""

    candidates: tuple[Effect, ...]
    start_s: Array
    """(B,) beginnings of the blocks, in s since the first step."""
    information: Array
    """(B, c, c) Lambda of each block."""
    score: Array
    """(B, c) b of each block."""
    features: FeatureScatter | None = None
    """Scatter over the features of all blocks; None where there are none."""

    def first_half(self) -> ScoreStatistics:
        """Return the statistics of the first half of the blocks; the scatter over features is that of all."""
        half = (len(self.start_s) + 1) // 2
        return replace(
            self,
            start_s=self.start_s[:half],
            information=self.information[:half],
            score=self.score[:half],
        )

    def excess_of_features(self, columns: IntArray, values: Array) -> Array:
        """Return the factors (q,) on the variances of estimates by the scatter over features; 1 at least.

        An effect on the yaw rate moves all features alike: blocks of time are its test.

        Args:
            columns: (q,) coefficients.
            values: (q,) their estimates.
        """
        if self.features is None:
            return np.ones(len(columns))
        places = [effect.acts_on for effect in self.candidates for _ in effect.coefficients]
        is_judged = [places[column] not in ('gyro', 'noise') for column in columns]
        return np.where(is_judged, np.maximum(self.features.excess(columns, values), 1.0), 1.0)


class ScoreRecorder:
    """Sums up the statistics of updates, block by block."""

    def __init__(self, candidates: tuple[Effect, ...]) -> None:
        self._candidates = candidates
        self._count = sum(len(effect.coefficients) for effect in candidates)
        self._information: list[Array] = []
        self._score: list[Array] = []
        self._features = FeatureScatterRecorder(self._count)

    def add(self, time_ns: int, updates: tuple[UpdateStats, ...], by_feature: FeatureScores | None) -> None:
        """Add the updates of one step of the filter, at a time since the first step.

        Args:
            time_ns: time since the first step.
            updates: statistics of the updates.
            by_feature: scores by feature; None without an image.
        """
        block = int(time_ns / (BLOCK_S * NS_PER_S))
        while len(self._score) <= block:
            self._information.append(np.zeros((self._count, self._count)))
            self._score.append(np.zeros(self._count))
            self._features.forget_lost()
        for stats in updates:
            if stats.information is not None and stats.score is not None:
                self._information[block] += stats.information
                self._score[block] += stats.score
        if by_feature is not None:
            self._features.add(by_feature)

    def scores(self) -> ScoreStatistics:
        """Return the statistics so far."""
        start_s = BLOCK_S * np.arange(len(self._score))
        return ScoreStatistics(
            self._candidates,
            start_s,
            np.array(self._information),
            np.array(self._score),
            self._features.scatter(),
        )
