"""Fits of candidate effects to the score statistics: estimates, significance, likelihood gains.

Everything follows from Lambda and b of the blocks (`ekf.history.score_statistics`), without another run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.history.score_statistics import ScoreStatistics
from gyrocal_ros.statistics import chi_square_tail, sigma_of, vuong_sigma

LAGS = 2
"""Number of following blocks whose scores may be correlated with a block: slow errors outlast a block."""
NOT_EXCITED = 1e-12
"""Information below which a recording does not excite a coefficient."""
SINGULAR = 1e-12
"""Ratio of eigenvalues below which a covariance is singular but for rounding."""
MAX_CONDITION = 1e10
"""Condition number above which coefficients cannot be fitted together."""
MAX_LEVERAGE = 0.98
"""Largest leverage of a block: one that alone decides an estimate leaves no scatter to judge it by."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Some candidate coefficients, fitted together."""

    columns: IntArray
    """(q,) indices of the coefficients among all candidates'."""
    values: Array
    """(q,) estimates."""
    covariance: Array
    """(q, q) covariance by the scatter of the blocks, independent of the filter's noise settings, or by that
    of the features, where it makes the estimate less significant."""
    gain: float
    """Log-likelihood gained, by the filter's own S."""
    block_gains: Array
    """(B,) contribution of each block to the gain."""
    clusters: int
    """Number of blocks, or of features, by whose scatter the covariance is known."""

    @property
    def wald(self) -> float:
        """Wald statistic: squared distance of the estimate from zero by its covariance."""
        return float(self.values @ np.linalg.solve(self.covariance, self.values))

    @property
    def sigma(self) -> float:
        """Significance in standard deviations of a normal variable."""
        return sigma_of(self.p_value)

    @property
    def p_value(self) -> float:
        """Probability of so large an estimate where the effect is absent."""
        return chi_square_tail(self.statistic, len(self.values))

    @property
    def statistic(self) -> float:
        """Chi-square of an estimate whose covariance is uncertain itself, because the clusters are few.

        One coefficient has Student's t distribution. The logarithm approximates that; for two coefficients
        it is Hotelling's test exactly.
        """
        dof = max(self.clusters - len(self.values), 1)
        return dof * math.log1p(self.wald / dof)


def fit(scores: ScoreStatistics, columns: IntArray, given: IntArray | None = None) -> Fit | None:
    """Fit candidate coefficients; return None where the recording does not excite them.

    Args:
        scores: score statistics of c candidate coefficients.
        columns: (q,) coefficients to fit.
        given: further coefficients to fit along; their gain does not count.
    """
    others = np.empty(0, np.int64) if given is None else given
    every = np.concatenate([columns, others]).astype(np.int64)
    information = scores.information[:, every[:, None], every]
    score = scores.score[:, every]
    total = information.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diagonal(total), NOT_EXCITED**2))
    excited = np.diagonal(total) > NOT_EXCITED
    if not excited[: len(columns)].any():
        return None
    kept = np.flatnonzero(excited)
    information = (information / (scale[:, None] * scale))[:, kept[:, None], kept]
    score, total = (score / scale)[:, kept], (total / (scale[:, None] * scale))[np.ix_(kept, kept)]
    spread, axes = np.linalg.eigh(total)
    if spread[0] * MAX_CONDITION < spread[-1]:
        return None
    root = axes / np.sqrt(spread)
    inverse = root @ root.T
    values = root @ (root.T @ score.sum(axis=0))
    wanted = np.flatnonzero(kept < len(columns))
    unscaled = 1.0 / scale[kept[wanted]]
    covariance = root @ _covariance_of_whitened(root.T @ information @ root, score @ root) @ root.T
    covariance = 0.5 * (covariance + covariance.T)
    block_gains = score @ values - 0.5 * np.einsum('i,bij,j->b', values, information, values)
    if len(others):
        block_gains = block_gains - _gains_of(information, score, kept >= len(columns))
    chosen, by_unit = np.ix_(wanted, wanted), unscaled[:, None] * unscaled
    by_blocks = Fit(
        columns=every[kept[wanted]],
        values=values[wanted] * unscaled,
        covariance=covariance[chosen] * by_unit,
        gain=float(block_gains.sum()),
        block_gains=block_gains,
        clusters=len(block_gains),
    )
    by_features = _judged_by_features(by_blocks, inverse[chosen] * by_unit, scores)
    return min(by_blocks, by_features, key=lambda item: item.statistic)


def _judged_by_features(fitted: Fit, covariance: Array, scores: ScoreStatistics) -> Fit:
    """Return a fit with the covariance by the scatter of the features; unchanged where there is none.

    Args:
        fitted: the fit.
        covariance: (q, q) by the filter's own S.
        scores: score statistics that it was fitted to.
    """
    if scores.features is None:
        return fitted
    root = np.sqrt(scores.excess_of_features(fitted.columns, fitted.values))
    return replace(fitted, covariance=root[:, None] * covariance * root, clusters=scores.features.count)


def held_out_gain(scores: ScoreStatistics, columns: IntArray) -> float | None:
    """Return the log-likelihood that candidates (q,) gain on the second half, fitted on the first half.

    None where the first half does not excite them.
    """
    fitted = fit(scores.first_half(), columns)
    if fitted is None:
        return None
    half, places = (len(scores.start_s) + 1) // 2, fitted.columns
    score = scores.score[half:, places].sum(axis=0)
    information = scores.information[half:, places[:, None], places].sum(axis=0)
    return float(fitted.values @ score - 0.5 * fitted.values @ information @ fitted.values)


def _gains_of(information: Array, score: Array, chosen: np.ndarray) -> Array:
    """Return the gain of the chosen columns alone in each block."""
    part = np.flatnonzero(chosen)
    information, score = information[:, part[:, None], part], score[:, part]
    values = np.linalg.solve(information.sum(axis=0), score.sum(axis=0))
    gains: Array = score @ values - 0.5 * np.einsum('i,bij,j->b', values, information, values)
    return gains


def _covariance_of_whitened(information: Array, score: Array) -> Array:
    """Return the covariance (q, q) of the estimate: of three, the one that makes it least significant.

    The filter's own S may be wrong, so the scatter of the blocks' scores counts (a sandwich,
    heteroscedasticity-consistent with the small-sample correction HC3 of MacKinnon and White 1985).
    Neighbouring blocks may be correlated (Bartlett weights, Newey and West 1987). An effect that shows in
    one block alone has no scatter, so the covariance by the filter's own S is a lower bound.

    Args:
        information: (B, q, q) of each block, in coordinates in which their sum is the unit matrix. In others
            the sandwich of coefficients that are much alike is nothing but rounding.
        score: (B, q) of each block, in the same coordinates.
    """
    values, unit = score.sum(axis=0), np.eye(score.shape[1])
    left = score - information @ values
    corrected = np.linalg.solve(unit - MAX_LEVERAGE * information, left[:, :, None])[:, :, 0]
    alone = corrected.T @ corrected
    neighbours = alone.copy()
    for lag in range(1, min(LAGS, len(left) - 1) + 1):
        cross = corrected[lag:].T @ corrected[:-lag]
        neighbours += (1.0 - lag / (LAGS + 1.0)) * (cross + cross.T)
    sound = [estimate for estimate in (unit, alone, neighbours) if _is_sound(estimate)]
    return min(sound, key=lambda estimate: float(values @ np.linalg.solve(estimate, values)))


def _is_sound(covariance: Array) -> bool:
    """Return True if a covariance is positive definite by more than rounding, beside the unit matrix.

    As many blocks as coefficients leave no scatter but rounding.
    """
    spread = np.linalg.eigvalsh(covariance)
    return bool(spread[0] > SINGULAR * max(spread[-1], 1.0))


def correlation(scores: ScoreStatistics, first: IntArray, second: IntArray) -> float:
    """Return the largest canonical correlation of two candidates in this recording."""
    total = scores.information.sum(axis=0)
    a, b = total[np.ix_(first, first)], total[np.ix_(second, second)]
    excited_a, excited_b = np.diagonal(a) > NOT_EXCITED, np.diagonal(b) > NOT_EXCITED
    first, second = first[excited_a], second[excited_b]
    if not len(first) or not len(second):
        return 0.0
    a, b = total[np.ix_(first, first)], total[np.ix_(second, second)]
    cross = total[np.ix_(first, second)]
    squared = np.linalg.solve(a, cross) @ np.linalg.solve(b, cross.T)
    return math.sqrt(min(max(float(np.linalg.eigvals(squared).real.max()), 0.0), 1.0))


def preference(better: Fit, worse: Fit) -> float:
    """Return by how many sigma one explanation gains more than another (Vuong 1989)."""
    return vuong_sigma(better.block_gains - worse.block_gains)
