"""Time series of a finished run: consistency over windows, distances from the truth, spans without camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.paths import Trajectory2D
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.statistics import chi_square_quantile

MAX_WINDOWS = 240
"""Maximum number of windows into which a run of any length is divided."""
MIN_WINDOW_S = 2.0
"""Minimum length of a window."""
MIN_CAMERA_OFF_S = 2.0
"""Minimum length of a gap between observed headings that is reported."""
CONFIDENCE = 0.95
"""Probability with which a consistent filter keeps within the bounds of a window."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Sums over the steps of the filter in w windows of equal length."""

    length_s: float
    time_s: Array
    """(w,) centres, since the first step."""
    nis_per_dof: Array
    """(w,) NaN where nothing was measured."""
    low: Array
    high: Array
    """(w,) bounds within which a consistent filter stays with the probability `CONFIDENCE`."""
    used: Array
    """(w,) features used, mean over the images of the window."""
    rejected: Array
    """(w,) features rejected in all images of the window."""

    @property
    def share_inside(self) -> float:
        """Part of the windows in which the NIS is within its bounds."""
        measured = np.isfinite(self.nis_per_dof)
        inside = (self.nis_per_dof >= self.low) & (self.nis_per_dof <= self.high)
        return float(inside.sum() / max(measured.sum(), 1))


def windows(history: History) -> Windows:
    """Sum the steps over at most `MAX_WINDOWS` windows."""
    time_s = history.time_s
    length_s = max(MIN_WINDOW_S, float(np.ceil(time_s[-1] / MAX_WINDOWS)))
    window = np.minimum(time_s / length_s, MAX_WINDOWS).astype(int)
    count = int(window.max()) + 1

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(window, values, count), float)

    dof, images = total(history.dof), total(np.asarray(history.dof > 0, float))
    bounds = np.array([_chi_square_bounds(int(n)) for n in dof])
    some = np.maximum(dof, 1.0)
    return Windows(
        length_s=length_s,
        time_s=(np.arange(count) + 0.5) * length_s,
        nis_per_dof=np.where(dof > 0, total(history.nis) / some, np.nan),
        low=bounds[:, 0] / some,
        high=bounds[:, 1] / some,
        used=total(history.used) / np.maximum(images, 1.0),
        rejected=total(history.rejected),
    )


def uncorrected(run: Run) -> Run:
    """Return the run with the gyro of the data sheet: no coefficient corrects a turn."""
    history = run.history
    nothing, no_columns = np.zeros_like(history.correction_rad), np.zeros_like(history.columns)
    return replace(run, history=replace(history, correction_rad=nothing, columns=no_columns))


def camera_off(history: History) -> list[tuple[float, float]]:
    """Return beginning and end (s) of spans without an observed heading, `MIN_CAMERA_OFF_S` or longer."""
    seen_s = history.time_s[np.isfinite(history.heading_innovation_rad) | (history.in_view > 0)]
    times = np.concatenate([history.time_s[:1], seen_s, history.time_s[-1:]])
    return [(low, high) for low, high in pairwise(times.tolist()) if high - low >= MIN_CAMERA_OFF_S]


def distances_m(tracks: Mapping[str, Trajectory2D], truth: Trajectory2D) -> tuple[Array, dict[str, Array]]:
    """Compute the distances of trajectories from the ground truth.

    Returns:
        Times (j,) and, by name, distances (j,).
    """
    time_s = truth.time_s
    apart = {
        name: [np.interp(time_s, track.time_s, column) for column in track.position_m.T] - truth.position_m.T
        for name, track in tracks.items()
    }
    return time_s, {name: np.hypot(*gap) for name, gap in apart.items()}


def rows_to_draw(columns: Array, limit: int) -> IntArray:
    """Select rows of a long table so that every bin of rows keeps the extremes of each column.

    Args:
        columns: (n, c), NaN allowed.
        limit: number of rows to keep, about.

    Returns:
        Sorted row numbers, the first and the last row among them.
    """
    count, width = columns.shape
    if count <= limit:
        return np.arange(count)
    edges = np.linspace(0, count, max(1, limit // (2 * width)) + 1).astype(int)
    lowest, highest = (
        [start + filled[start:end].argmin(axis=0) for start, end in pairwise(edges.tolist())]
        for filled in (np.nan_to_num(columns, nan=np.inf), np.nan_to_num(-columns, nan=np.inf))
    )
    return np.unique(np.concatenate([[0, count - 1], *lowest, *highest]))


def _chi_square_bounds(dof: int) -> tuple[float, float]:
    if dof == 0:
        return math.nan, math.nan
    tail = (1.0 - CONFIDENCE) / 2.0
    return chi_square_quantile(tail, dof), chi_square_quantile(1.0 - tail, dof)
