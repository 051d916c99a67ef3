"""Headings and trajectories over a run: by the filter, and by the ground truth in the frame of its map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array
from gyrocal_ros.ekf.history.run import GroundTruth, Run
from gyrocal_ros.ekf.state.layout import YAW

GAP_INTERVALS = 3.0
"""Time between two headings, in usual intervals, from which it is a gap: nothing is compared within."""


@dataclass(frozen=True, slots=True, eq=False)
class Heading:
    """Heading over time, by one source."""

    time_s: Array
    yaw_rad: Array
    """(n,) unwrapped."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory2D:
    """Position and heading over time, by one source."""

    time_s: Array
    position_m: Array
    """(n, 2)"""
    yaw_rad: Array
    """(n,) unwrapped."""


def slam_path(run: Run) -> Trajectory2D:
    """Return the trajectory by the filter."""
    history = run.history
    return Trajectory2D(history.time_s, history.mean[:, :2], history.mean[:, YAW])


def truth_path(run: Run) -> Trajectory2D | None:
    """Return the ground truth, aligned to the map's frame where the map begins."""
    heading, truth = truth_heading(run), run.truth
    if heading is None or truth is None:
        return None
    slam, time_s = slam_path(run), heading.time_s
    common = _common(truth, run)
    position, turn = truth.position_m[common], heading.yaw_rad[0] - truth.yaw_rad[common][0]
    at_first = [np.interp(time_s[0], slam.time_s, column) for column in slam.position_m.T]
    c, s = np.cos(turn), np.sin(turn)
    moved = (position - position[0]) @ np.array([[c, s], [-s, c]]) + at_first
    return Trajectory2D(time_s, moved, heading.yaw_rad)


def truth_heading(run: Run) -> Heading | None:
    """Return the heading by the ground truth, aligned to the map's frame where the map begins."""
    if run.truth is None:
        return None
    slam = slam_path(run)
    common = _common(run.truth, run)
    time_s, yaw = run.truth.time_s[common], run.truth.yaw_rad[common]
    if len(time_s) < 2:
        return None
    # Full turns are those of the filter: ground truth may have been frozen, or away, while the robot turned.
    own = np.interp(time_s, slam.time_s, slam.yaw_rad)
    apart = (yaw - yaw[0]) - (own - own[0])
    return Heading(time_s, own + np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi)


def is_known(heading: Heading, time_s: Array) -> NDArray[np.bool_]:
    """Return True (s,) for times (s,) that are not in a gap of a heading."""
    before_s = np.diff(heading.time_s, prepend=heading.time_s[0], append=heading.time_s[-1])
    longest_s = GAP_INTERVALS * float(np.median(before_s))
    known: NDArray[np.bool_] = before_s[heading.time_s.searchsorted(time_s)] <= longest_s
    return known


def _common(truth: GroundTruth, run: Run) -> slice:
    """Return the rows of the ground truth, which are in order, from the beginning of the map to the end.

    The image before the first one that shows mapped features has begun it, where the pose is exact.
    """
    history = run.history
    sees = np.flatnonzero((history.in_view > 0) | (history.dof > 0))
    first_s, last_s = history.time_s[max(sees[0] - 1, 0) if len(sees) else 0], history.time_s[-1]
    return slice(truth.time_s.searchsorted(first_s), truth.time_s.searchsorted(last_s, 'right'))
