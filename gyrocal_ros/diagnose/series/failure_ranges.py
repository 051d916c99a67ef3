"""Where a failure of the model lies on the axes of the figures: stretches of time, and values of signals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrocal_ros.data import Array
from gyrocal_ros.diagnose.analysis.regimes import Failure, regimes
from gyrocal_ros.diagnose.analysis.shapes import HEADING, TIME, axes
from gyrocal_ros.ekf.history.run import Run

Ranges = dict[str, list[tuple[float, float]]]
"""Lower and upper ends by name of the axis."""

MAX_GAP_S = 1.0
"""Stretches of time with a smaller gap between them are one."""
MAX_STRETCHES = 40
"""Maximum number of stretches of time; the longest are taken."""
INNER = (0.05, 0.95)
"""Quantiles of a signal between which it is said to lie."""
MAX_PART = 0.8
"""A range wider than this part of all values of the signal does not say where the failure is."""


def failure_ranges(run: Run, failures: Sequence[Failure]) -> list[Ranges]:
    """Return where each failure lies: its stretches of time, and its range of each signal that locates it."""
    columns: dict[str, Array] = {}
    for regime in regimes(run):
        columns.setdefault(regime.name, regime.column)  # the second of a name is of the turns among them
    return [_ranges(run, _steps(run, failure, columns)) for failure in failures]


def _steps(run: Run, failure: Failure, columns: dict[str, Array]) -> NDArray[np.bool_]:
    """Select the steps (s,) of a failure."""
    if failure.regime is not None:
        return columns[failure.regime] != 0.0
    time_s = run.history.time_s
    return (time_s >= (failure.from_s or 0.0)) & (time_s <= (failure.to_s or np.inf))


def _ranges(run: Run, steps: NDArray[np.bool_]) -> Ranges:
    if not steps.any():
        return {}
    found: Ranges = {TIME: _stretches(run.history.time_s[steps])}
    for name, values in axes(run):
        known = np.isfinite(values)
        if name in (TIME, HEADING) or not np.any(known & steps):
            continue  # the heading is a circle, on which a failure is seldom one range
        low, high = np.quantile(values[known & steps], INNER).tolist()
        if 0.0 < high - low < MAX_PART * np.ptp(values[known]):
            found[name] = [(low, high)]
    return found


def _stretches(time_s: Array) -> list[tuple[float, float]]:
    """Join times (n,) to stretches, in the order of time."""
    ends = np.flatnonzero(np.diff(time_s) > MAX_GAP_S)
    first, last = np.append(0, ends + 1), np.append(ends, len(time_s) - 1)
    longest = np.sort(np.argsort(time_s[first] - time_s[last], kind='stable')[:MAX_STRETCHES])
    return list(zip(time_s[first[longest]].tolist(), time_s[last[longest]].tolist(), strict=True))
