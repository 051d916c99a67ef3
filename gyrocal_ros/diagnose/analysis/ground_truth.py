"""What is wrong with a ground truth that gyro and map contradict.

Ground truth is only compared with. A wrong one must not make a good calibration look bad.
"""

from __future__ import annotations

import math

import numpy as np

from gyrocal_ros.diagnose.analysis.drift import SPAN_S, TRUTH, blind_drift, held_out_from_s, reference_heading
from gyrocal_ros.diagnose.analysis.paths import Heading, slam_path, truth_heading
from gyrocal_ros.ekf.history.run import Run

LATE_PART = 0.8
"""Part of the variance of the errors of a ground truth from which a time offset is said to be its fault."""
ROUNDS = 4
"""Number of steps to find a time offset: the first is exact for small ones only."""


def truth_fault(run: Run) -> tuple[str, str]:
    """Return what is wrong with the ground truth of a run, and what to do about it; both empty without."""
    truth = truth_heading(run)
    if truth is None or reference_heading(run)[1] == TRUTH:
        return '', ''
    drift = blind_drift(run, (truth, TRUTH), held_out_from_s(run))
    turns = f'by {drift.rms_deg:.3g} deg in {SPAN_S:.0f} s'
    if _turns_the_other_way(run):
        return (
            'the ground truth turns opposite to gyro and camera',
            'Give its heading counterclockwise, with the z axis up (REP 103).',
        )
    late_s, explained = _lateness(run, truth)
    if explained > LATE_PART:
        word = 'late' if late_s > 0.0 else 'early'
        return (
            f'the ground truth is {abs(late_s) * 1e3:.0f} ms {word}, so that nothing is compared with it',
            'Correct its stamps.',
        )
    return (
        f'the ground truth drifts or jumps against gyro and camera, {turns}',
        'Look at its heading; without it, the calibration is the same.',
    )


def _turns_the_other_way(run: Run) -> bool:
    """Return True if most of the turning is with the opposite sign."""
    assert run.truth is not None
    slam = slam_path(run)
    inside = (slam.time_s >= run.truth.time_s[0]) & (slam.time_s <= run.truth.time_s[-1])
    turns = np.diff(slam.yaw_rad[inside])
    by_truth = np.diff(np.interp(slam.time_s[inside], run.truth.time_s, run.truth.yaw_rad))
    return float(turns @ by_truth) < -0.5 * float(turns @ turns)


def _lateness(run: Run, truth: Heading) -> tuple[float, float]:
    """Return the time offset of the ground truth, and the part of the variance of its errors it explains."""
    slam, late_s = slam_path(run), 0.0
    rate = np.gradient(slam.yaw_rad, slam.time_s)
    before = after = math.nan
    for _ in range(ROUNDS):
        at_s = truth.time_s - late_s
        inside = (at_s >= slam.time_s[0]) & (at_s <= slam.time_s[-1])
        error = np.interp(at_s, slam.time_s, slam.yaw_rad)[inside] - truth.yaw_rad[inside]
        by_rate = np.stack([np.interp(at_s, slam.time_s, rate)[inside], np.ones(inside.sum())], axis=1)
        (step_s, offset), *_ = np.linalg.lstsq(by_rate, error, rcond=None)
        after = float(np.var(error))
        before = after if math.isnan(before) else before
        late_s += float(step_s)
    return late_s, 1.0 - after / before if before > 0.0 else 0.0
