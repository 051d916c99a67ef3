"""What the evidence says: estimates, honest significance, likelihood gains, twins.

All of it follows from Lambda and b of the blocks (`ekf.scores`), without another replay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.score_statistics import ScoreStatistics

LAGS = 2
"""Blocks whose scores may depend on each other: what wanders slowly outlasts a block."""
SIGNIFICANT_SIGMA = 4.0
"""Below this an estimate counts as chance: many are looked at."""
NOT_EXCITED = 1e-12
SINGULAR = 1e-12
MAX_LEVERAGE = 0.98
"""A block that alone decides an estimate leaves no scatter to judge it by."""
SMALLEST = 1e-300
"""Chance, as far as numbers reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Some candidate coefficients, fitted together."""

    columns: IntArray
    """(q,) which coefficients."""
    values: Array
    """(q,)"""
    covariance: Array
    """(q, q) by the scatter of the blocks, whatever the filter's noise settings are."""
    gain: float
    """Log-likelihood gained, by the filter's own S."""
    block_gains: Array
    """(B,) where it is gained."""

    @property
    def wald(self) -> float:
        """Squared distance of the estimate from zero by its covariance."""
        return float(self.values @ np.linalg.solve(self.covariance, self.values))

    @property
    def sigma(self) -> float:
        """Significance as that of a normal variable."""
        return sigma_of(self.p_value)

    @property
    def p_value(self) -> float:
        """Chance of so large an estimate where there is nothing.

        A doubt that comes from the scatter of few blocks is itself in doubt: Student's t, here and for
        several coefficients by the logarithm, which for two is Hotelling's test exactly.
        """
        dof = max(len(self.block_gains) - len(self.values), 1)
        return chi_square_tail(dof * math.log1p(self.wald / dof), len(self.values))


def fit(scores: ScoreStatistics, columns: IntArray, given: IntArray | None = None) -> Fit | None:
    """Fit candidate coefficients; None where the recording does not excite them.

    Args:
        evidence: of c candidate coefficients.
        columns: (q,) those to fit.
        given: further ones to fit along, whose effect is not counted as gain.
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
    if np.linalg.cond(total) > 1e10:
        return None
    inverse = np.linalg.inv(total)
    values = inverse @ score.sum(axis=0)
    covariance = _covariance(information, score, values, inverse)
    block_gains = score @ values - 0.5 * np.einsum('i,bij,j->b', values, information, values)
    if len(others):
        block_gains = block_gains - _gains_of(information, score, kept >= len(columns))
    wanted = np.flatnonzero(kept < len(columns))
    unscaled = 1.0 / scale[kept[wanted]]
    return Fit(
        columns=every[kept[wanted]],
        values=values[wanted] * unscaled,
        covariance=covariance[np.ix_(wanted, wanted)] * unscaled[:, None] * unscaled,
        gain=float(block_gains.sum()),
        block_gains=block_gains,
    )


def held_out_gain(scores: ScoreStatistics, columns: IntArray) -> float | None:
    """Log-likelihood that candidates (q,) gain on the second half, fitted on the first half alone.

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
    """Gain by block of the chosen columns alone."""
    part = np.flatnonzero(chosen)
    information, score = information[:, part[:, None], part], score[:, part]
    values = np.linalg.solve(information.sum(axis=0), score.sum(axis=0))
    gains: Array = score @ values - 0.5 * np.einsum('i,bij,j->b', values, information, values)
    return gains


def _covariance(information: Array, score: Array, values: Array, inverse: Array) -> Array:
    """Covariance of the estimate: the most cautious of three views of it.

    The filter's own S may be wrong, so the scatter of the blocks' scores counts (a sandwich,
    heteroscedasticity-consistent with the small-sample correction HC3 of MacKinnon and White 1985).
    Neighbouring blocks may depend on each other (Bartlett weights, Newey and West 1987). And what
    shows in one block alone has no scatter, so the filter's own S is the least.
    """
    left = score - information @ values
    leverage = MAX_LEVERAGE * (information @ inverse)
    corrected = np.linalg.solve(np.eye(len(values)) - leverage, left[:, :, None])[:, :, 0]
    alone = corrected.T @ corrected
    neighbours = alone.copy()
    for lag in range(1, min(LAGS, len(left) - 1) + 1):
        cross = corrected[lag:].T @ corrected[:-lag]
        neighbours += (1.0 - lag / (LAGS + 1.0)) * (cross + cross.T)
    views = [inverse, inverse @ alone @ inverse, inverse @ neighbours @ inverse]
    sound = [view for view in views if _is_sound(view)]
    return min(sound, key=lambda view: float(values @ np.linalg.solve(view, values)))


def _is_sound(covariance: Array) -> bool:
    """Whether a covariance is positive definite by more than rounding: few blocks give fewer directions."""
    spread = np.linalg.eigvalsh(covariance)
    return bool(spread[0] > SINGULAR * spread[-1])


def correlation(scores: ScoreStatistics, first: IntArray, second: IntArray) -> float:
    """How far two candidates are the same to this recording: largest canonical correlation."""
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
    """By how many sigma one explanation gains more than another (Vuong 1989): mean over scatter."""
    difference = better.block_gains - worse.block_gains
    scatter = float(difference.std(ddof=1)) * math.sqrt(len(difference))
    return float(difference.sum()) / scatter if scatter > 0.0 else 0.0


def chi_square_tail(value: float, dof: int) -> float:
    """Chance that a chi-square variable exceeds a value; exact for 1 and 2 degrees of freedom."""
    if dof == 1:
        return math.erfc(math.sqrt(max(value, 0.0) / 2.0))
    if dof == 2:
        return math.exp(-max(value, 0.0) / 2.0)
    width = 2.0 / (9.0 * dof)
    return NormalDist().cdf(-((max(value, 0.0) / dof) ** (1.0 / 3.0) - 1.0 + width) / math.sqrt(width))


def sigma_of(p_value: float) -> float:
    """Two-sided normal quantile; chances too small for a number count as the smallest one."""
    return -NormalDist().inv_cdf(min(max(p_value, SMALLEST) / 2.0, 0.5))
