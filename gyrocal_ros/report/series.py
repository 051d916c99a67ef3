"""What a report shows that does not stand in a run as it is, as plain arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.drift import Trajectory2D, slam_path, truth_path
from gyrocal_ros.ekf.run import History, Run
from gyrocal_ros.ekf.state import YAW
from gyrocal_ros.statistics import chi_square_quantile

WINDOWS = 240
"""A run of any length is summed up in no more windows than this."""
SHORTEST_WINDOW_S = 2.0
SHORTEST_BLIND_S = 2.0
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Steps of the filter summed up over windows of equal length, w of them."""

    length_s: float
    time_s: Array
    """(w,) middles, since the first step."""
    nis_per_dof: Array
    """(w,) NaN where nothing was measured."""
    low: Array
    high: Array
    """(w,) what a consistent filter keeps between with the probability `CONFIDENCE`."""
    used: Array
    """(w,) features used, mean over the images of the window."""
    rejected: Array
    """(w,) features rejected, all images of the window together."""

    @property
    def share_inside(self) -> float:
        """Part of the windows in which the NIS is within its bounds."""
        measured = np.isfinite(self.nis_per_dof)
        inside = (self.nis_per_dof >= self.low) & (self.nis_per_dof <= self.high)
        return float(inside.sum() / max(measured.sum(), 1))


@dataclass(frozen=True, slots=True, eq=False)
class HeadingError:
    """Heading by the filter less the ground truth, aligned at the first common moment."""

    time_s: Array
    """(s,) steps of the filter for which there is ground truth."""
    error_rad: Array
    std_rad: Array
    """(s,) what the filter says of itself."""


def uncorrected(run: Run) -> Run:
    """The same run with the gyro as its data sheet has it: no coefficient corrects a turn."""
    history = run.history
    nothing, no_columns = np.zeros_like(history.correction_rad), np.zeros_like(history.columns)
    return replace(run, history=replace(history, correction_rad=nothing, columns=no_columns))


def windows(history: History) -> Windows:
    """Sum the steps up, so that an hour is as easy to look at as a minute."""
    time_s = history.time_s
    length_s = max(SHORTEST_WINDOW_S, float(np.ceil(time_s[-1] / WINDOWS)))
    window = np.minimum(time_s / length_s, WINDOWS).astype(int)
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


def camera_off(history: History) -> list[tuple[float, float]]:
    """Stretches of time (s) in which the heading was not seen for `SHORTEST_BLIND_S` or longer."""
    seen_s = history.time_s[np.isfinite(history.heading_innovation_rad)]
    times = np.concatenate([history.time_s[:1], seen_s, history.time_s[-1:]])
    return [(low, high) for low, high in pairwise(times.tolist()) if high - low >= SHORTEST_BLIND_S]


def heading_error(run: Run) -> HeadingError | None:
    """The heading error where there is ground truth."""
    truth = truth_path(run)
    if truth is None:
        return None
    slam = slam_path(run)
    both = (slam.time_s >= truth.time_s[0]) & (slam.time_s <= truth.time_s[-1])
    time_s = slam.time_s[both]
    error = slam.yaw_rad[both] - np.interp(time_s, truth.time_s, truth.yaw_rad)
    return HeadingError(time_s, error, run.history.std[both, YAW])


def distances_m(tracks: Mapping[str, Trajectory2D], truth: Trajectory2D) -> tuple[Array, dict[str, Array]]:
    """How far paths are from the ground truth.

    Returns:
        Times (j,) and, by name, distances (j,).
    """
    time_s = truth.time_s
    apart = {
        name: [np.interp(time_s, track.time_s, column) for column in track.position_m.T] - truth.position_m.T
        for name, track in tracks.items()
    }
    return time_s, {name: np.hypot(*gap) for name, gap in apart.items()}


def kept(columns: Array, limit: int) -> IntArray:
    """Which rows of a long table to draw: every bin keeps the extremes of each column.

    Args:
        columns: (n, c), NaN allowed.
        limit: about so many rows remain.

    Returns:
        Sorted row numbers, with the first and the last row.
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


def quaternions(euler_rad: Array) -> Array:
    """Attitudes (s, 4) as x, y, z, w from roll, pitch, yaw (s, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler_rad.T / 2.0), np.sin(euler_rad.T / 2.0)
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )


def _chi_square_bounds(dof: int) -> tuple[float, float]:
    if dof == 0:
        return math.nan, math.nan
    tail = (1.0 - CONFIDENCE) / 2.0
    return chi_square_quantile(tail, dof), chi_square_quantile(1.0 - tail, dof)
