"""Comparison of models by predictive log-likelihood: each measurement is scored before it is used."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import BLOCK_S


def predictive_gain(before: Run, after: Run) -> Array:
    """Return the log-likelihood that one run gains over another of the same recording, (B,) by block of time.

    The prequential log-likelihood (Dawid 1984) sums the log-likelihood of each measurement given all before
    it, so further coefficients have already paid for themselves. Using more or fewer features neither helps
    nor harms.
    """
    measured = before.history.dof > 0
    usual = float(before.history.log_likelihood[measured].sum() / before.history.dof.sum())
    count = 1 + int(max(run.history.time_s[-1] for run in (before, after)) / BLOCK_S)
    first, second = (
        np.bincount((h.time_s / BLOCK_S).astype(int), h.log_likelihood - usual * h.dof, count)
        for h in (before.history, after.history)
    )
    return np.subtract(second, first, dtype=float)
