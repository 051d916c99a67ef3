"""Which of two models foresees a recording better: each measurement is judged before it is used."""

from __future__ import annotations

import numpy as np

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import BLOCK_S


def predictive_gain(before: Run, after: Run) -> Array:
    """Log-likelihood that one run gains over another of the same recording, (B,) by blocks of time.

    It is that of each measurement given all before it, so what a further coefficient costs is paid
    already. To have used more features, or fewer, neither helps nor harms.
    """
    measured = before.history.dof > 0
    usual = float(before.history.log_likelihood[measured].sum() / before.history.dof.sum())
    count = 1 + int(max(run.history.time_s[-1] for run in (before, after)) / BLOCK_S)
    first, second = (
        np.bincount((h.time_s / BLOCK_S).astype(int), h.log_likelihood - usual * h.dof, count)
        for h in (before.history, after.history)
    )
    return np.subtract(second, first, dtype=float)


def vuong_sigma(gains: Array) -> float:
    """By how many sigma a gain (B,) is more than chance (Vuong 1989): mean over scatter."""
    scatter = float(gains.std(ddof=1)) * float(np.sqrt(len(gains))) if len(gains) > 1 else 0.0
    return float(gains.sum()) / scatter if scatter > 0.0 else 0.0
