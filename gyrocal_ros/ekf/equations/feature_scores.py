"""Score statistics by feature: errors that stay with a feature are not chance.

The filter takes the errors of a feature in successive images as independent. Some are not: a corner that a
near beam cuts out of the ceiling behind it moves with the view, and a matching error lasts. Such errors look
like a camera that is mounted elsewhere, image after image, so blocks of time do not show that they are
chance. But they differ from feature to feature. Where the scores of the features scatter more than the
filter's own S explains, an estimate is less certain by that factor (clusters of dependent observations: Liang
and Zeger 1986; a factor on the variance: McCullagh and Nelder 1989, sec. 4.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.kernels import compiled


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScores:
    """Shares of m features in the score statistics of one image, for c candidate coefficients."""

    ids: IntArray
    """(m,)"""
    sums: Array
    """(m, 2, c) score `G_f^T (S^-1 nu)_f` and information, the diagonal of `G_f^T (S^-1 G)_f`; their sums
    over the features are the score b of the image and the diagonal of its Lambda."""
    variance: Array
    """(c,) sum over the features of the variances of their scores, the diagonal of `G_f^T (S^-1)_ff G_f`."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureScatter:
    """Sums over all features of products of their scores u and information i, for c coefficients."""

    uu: Array
    """(c,)"""
    ui: Array
    """(c,)"""
    ii: Array
    """(c,)"""
    variance: Array
    """(c,) the sum of u^2 that the filter's own S explains."""
    count: int
    """Number of features."""

    def excess(self, columns: IntArray, values: Array) -> Array:
        """Return by what factor (q,) the scores of the features scatter more than S explains.

        Args:
            columns: (q,) indices of coefficients.
            values: (q,) their estimates; the scatter is that about them.
        """
        uu, ui, ii = self.uu[columns], self.ui[columns], self.ii[columns]
        scatter = uu - 2.0 * values * ui + values**2 * ii
        factor: Array = scatter / np.maximum(self.variance[columns], np.finfo(float).tiny)
        return factor

    def mixed(self, mixing: Array) -> FeatureScatter:
        """Return the scatter of other coefficients.

        Args:
            mixing: (c, k) what each of k coefficients is made of: one of the c each.
        """
        squared = mixing**2
        uu, ui, ii = self.uu @ squared, self.ui @ squared, self.ii @ squared
        return FeatureScatter(uu, ui, ii, self.variance @ squared, self.count)


def feature_scores(ids: IntArray, residual: Array, whitening: Array, sensitivity: Array) -> FeatureScores:
    """Split the score statistics of an update by feature.

    Args:
        ids: (m,) numbers of the features.
        residual: nu (m, r).
        whitening: L^-1 (m r, m r) with `L L^T = S`.
        sensitivity: G (m, r, c).
    """
    both = np.concatenate([sensitivity, residual[:, :, None]], axis=2)
    weighted = whitening.T @ (whitening @ both.reshape(residual.size, -1))
    return FeatureScores(ids, *split_by_feature(both, weighted, whitening))


@compiled
def split_by_feature(both: Array, weighted: Array, whitening: Array) -> tuple[Array, Array]:
    """Return sums (m, 2, c) and variance (c,) of `FeatureScores`.

    Args:
        both: (m, r, c + 1) side by side G and nu.
        weighted: (m r, c + 1) S^-1 times these.
        whitening: L^-1 (m r, m r) with `L L^T = S`.
    """
    m, r, width = both.shape
    by_feature = weighted.reshape(m, r, width)
    each = np.arange(m)
    own = (whitening.T @ whitening).reshape(m, r, m, r)[each, :, each, :]
    G = both[:, :, :-1]
    score, information = G * by_feature[:, :, -1:], G * by_feature[:, :, :-1]
    return np.stack([score, information], axis=1).sum(axis=2), np.sum(G * (own @ G), axis=(0, 1))


class FeatureScatterRecorder:
    """Sums up the scores of each feature while it is seen, and their products once it is gone."""

    def __init__(self, count: int) -> None:
        self._seen: dict[int, Array] = {}
        """(2, c) score and information of each feature seen."""
        self._lately: set[int] = set()
        self._variance = np.zeros(count)
        self._products = np.zeros((3, count))
        self._lost = 0

    def add(self, scores: FeatureScores) -> None:
        """Add the features of one image."""
        self._variance += scores.variance
        ids = scores.ids.tolist()
        for feature, added in zip(ids, scores.sums, strict=True):
            before = self._seen.get(feature)
            self._seen[feature] = added.copy() if before is None else np.add(before, added, out=before)
        self._lately.update(ids)

    def forget_lost(self) -> None:
        """Keep only the products of the features not seen since the last call, so that memory is bounded."""
        for feature in self._seen.keys() - self._lately:
            self._lost += 1
            self._products += _products(self._seen.pop(feature))
        self._lately.clear()

    def scatter(self) -> FeatureScatter | None:
        """Return the sums so far; None where no feature was seen."""
        if not self._variance.any():
            return None
        products = self._products + sum(map(_products, self._seen.values()), np.zeros_like(self._products))
        uu, ui, ii = products
        return FeatureScatter(uu, ui, ii, self._variance.copy(), self._lost + len(self._seen))


def _products(sums: Array) -> Array:
    """Return u^2, u i and i^2 (3, c) of one feature."""
    score, information = sums
    return np.stack([score**2, score * information, information**2])
