"""Comparison of models by predictive log-likelihood: each measurement is scored before it is used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.ekf.history.feature_likelihoods import FeatureLikelihoods
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S

UNKNOWN_HEADING = math.log(2.0 * math.pi)
"""Negative log-likelihood of a heading of which nothing is known."""
MIN_SHARED = 0.5
"""Share of the features of an image, by the run that uses more, that both have to use to be compared by."""


def predictive_gain(before: Run, after: Run) -> Array:
    """Return the log-likelihood that one run gains over another of the same recording, (B,) by block of time.

    The prequential log-likelihood (Dawid 1984) sums the log-likelihood of each measurement given all before
    it, so further coefficients have already paid for themselves. Using more or fewer features neither helps
    nor harms: of an image those count that both runs use. Where these are few, each counts as a usual one. An
    image counts for neither while coefficients of one of them wait for the camera to move. A heading that is
    not used counts as one of which nothing is known: else a run that takes every turn for a jump of the
    reference would predict best.
    """
    usual = _usual(before)
    scores = [
        run.history.log_likelihood - usual * run.history.dof - (usual + UNKNOWN_HEADING) * _lost_headings(run)
        for run in (before, after)
    ]
    if before.features is not None and after.features is not None:
        steps = min(len(score) for score in scores)
        sides = [
            _OneSide.of(before.features, after.features, steps),
            _OneSide.of(after.features, before.features, steps),
        ]
        shared, most = sides[0].used - sides[0].unshared, np.maximum(sides[0].used, sides[1].used)
        tells = np.flatnonzero((most > 0) & (shared >= MIN_SHARED * most))
        for run, score, side in zip((before, after), scores, sides, strict=True):
            score[tells] = run.history.log_likelihood[tells] - side.log_likelihood[tells]
    both = min(len(score) for score in scores)
    waits = (before.history.waits[:both] > 0) | (after.history.waits[:both] > 0)
    for score in scores:
        score[:both][waits] = 0.0
    count = 1 + int(max(run.history.time_s[-1] for run in (before, after)) / BLOCK_S)
    first, second = (
        np.bincount((run.history.time_s / BLOCK_S).astype(int), score, count)
        for run, score in zip((before, after), scores, strict=True)
    )
    return np.subtract(second, first, dtype=float)


def _lost_headings(run: Run) -> IntArray:
    """Return the number (s,) of headings of another reference that were not used."""
    history = run.history
    if run.rig.camera is not None:
        return np.zeros(len(history.log_likelihood), np.int64)
    return history.rejected.astype(np.int64) * (history.dof == 0)


def _usual(run: Run) -> float:
    """Return the log-likelihood of a usual measurement, by degree of freedom."""
    history = run.history
    return float(history.log_likelihood[history.dof > 0].sum() / history.dof.sum())


@dataclass(frozen=True, slots=True, eq=False)
class _OneSide:
    """The features of one of two runs, over s steps."""

    used: IntArray
    """(s,) their number."""
    unshared: IntArray
    """(s,) the number of those that the other run does not use."""
    log_likelihood: Array
    """(s,) what these contribute."""

    @classmethod
    def of(cls, own: FeatureLikelihoods, other: FeatureLikelihoods, steps: int) -> _OneSide:
        """Compare the features of a run with those of another one."""
        every = np.union1d(own.ids, other.ids)
        mine, theirs = (
            len(every) * each.steps.astype(int) + np.searchsorted(every, each.ids) for each in (own, other)
        )
        alone = ~np.isin(mine, theirs)
        at = own.steps[alone]
        return cls(
            np.bincount(own.steps, minlength=steps)[:steps],
            np.bincount(at, minlength=steps)[:steps],
            np.bincount(at, own.log_likelihoods[alone], steps)[:steps].astype(float),
        )
