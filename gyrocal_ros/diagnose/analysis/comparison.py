"""Comparison of several models on one recording: predictive log-likelihood, drift, where each fails."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gyrocal_ros.diagnose.analysis.drift import (
    BlindDrift,
    better_sigma,
    blind_drift,
    heading_rms_deg,
    held_out_from_s,
    reference_heading,
)
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, headings
from gyrocal_ros.diagnose.analysis.paths import truth_heading
from gyrocal_ros.diagnose.analysis.predictive_gain import predictive_gain
from gyrocal_ros.diagnose.analysis.regimes import Failure, failures
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.statistics import vuong_sigma

TRUTH_STD_DEG = 0.05
"""Assumed standard deviation of the heading of a ground truth."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelResult:
    """One model on the recording."""

    label: str
    """File of the model, or `default`."""
    run: Run
    heading_rms_deg: float | None
    """Heading error of the filter against the ground truth; None without one."""
    drift: BlindDrift
    """Held-out blind drift: each span starts with what was known by then."""
    gain: float
    """Predictive log-likelihood gained over the first model; 0 for that one."""
    gain_sigma: float
    """Significance of that gain."""
    drift_sigma: float
    """Significance of the decrease of the drift relative to the first model."""
    fails_where: tuple[Failure, ...]
    """Places where gyro and camera differ by more than chance, worst first."""
    fails_by_truth: tuple[Failure, ...] | None
    """Places where gyro and ground truth differ; None without ground truth."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Models that ran over one recording, in the order given."""

    results: tuple[ModelResult, ...]
    drift_reference: str
    """Reference of the drift: `ground truth`, or `slam` by the best model."""
    diverged: Mapping[str, str] = field(default_factory=dict)
    """Models with which the filter diverged, and why."""

    @property
    def best(self) -> ModelResult:
        """The model that predicts the recording best."""
        return max(self.results, key=lambda result: result.gain)


def compare(runs: Mapping[str, Run], diverged: Mapping[str, str] | None = None) -> Comparison:
    """Compare runs of the same recording.

    Args:
        runs: one or more finished runs by the label of their model; gains are relative to the first.
        diverged: models with which the filter diverged, and why.
    """
    first = next(iter(runs.values()))
    gains = {label: predictive_gain(first, run) for label, run in runs.items()}
    best = max(runs, key=lambda label: float(gains[label].sum()))
    reference = reference_heading(runs[best])
    from_s = held_out_from_s(first)
    drifts = {label: blind_drift(run, reference, from_s) for label, run in runs.items()}
    results = []
    for label, run in runs.items():
        by_truth = headings_by_truth(run)
        results.append(
            ModelResult(
                label=label,
                run=run,
                heading_rms_deg=heading_rms_deg(run),
                drift=drifts[label],
                gain=float(gains[label].sum()),
                gain_sigma=vuong_sigma(gains[label]),
                drift_sigma=0.0 if run is first else better_sigma(next(iter(drifts.values())), drifts[label]),
                fails_where=tuple(failures(run, headings(run))),
                fails_by_truth=None if by_truth is None else tuple(failures(run, by_truth)),
            )
        )
    return Comparison(tuple(results), reference[1], dict(diverged or {}))


def headings_by_truth(run: Run) -> Headings | None:
    """Return the headings of a run with the ground truth in place of the camera; None without one."""
    truth = truth_heading(run)
    if truth is None:
        return None
    seen = headings(run)
    known = (seen.time_s >= truth.time_s[0]) & (seen.time_s <= truth.time_s[-1])
    yaw = np.interp(seen.time_s, truth.time_s, truth.yaw_rad)
    std_rad = np.full(len(yaw), math.radians(TRUTH_STD_DEG))
    return replace(seen, seen_rad=np.where(known, yaw, np.nan), std_rad=std_rad)
