"""Whether the model fits a recording, whatever it may lack."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import seconds
from gyrocal_ros.diagnose.analysis.drift import (
    MAX_DRIFT_RATIO,
    SPAN_S,
    BlindDrift,
    blind_drift,
    drift_by_noise_deg,
    held_out_from_s,
    last_seen_s,
)
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.history.scatter import Scatter, scatter_of
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.ekf.map_watch import LOSES_MAPS, loses_its_map
from gyrocal_ros.ekf.noise.noise_bank import MUCH_WALK, walks_more
from gyrocal_ros.ekf.watches.scale_watch import SCALE_CHANGED
from gyrocal_ros.statistics import nis_per_dof

CALIBRATED_S = 60.0
"""Time after which a change of the scale factor is none of an earlier calibration that was wrong."""
MAX_FOLLOWED = 3
"""Largest number of changes that a run follows, whatever was known of the scale factor before."""
UNSEEN = 'too few images or headings confirm the model'
MIN_SEEN_PART = 0.5
"""Part of a recording: where images or headings end before it, this is why the recording cannot tell."""


@dataclass(frozen=True, slots=True)
class ModelFit:
    """What contradicts the model."""

    misfits: tuple[str, ...]
    """Contradictions, as clauses; empty without."""
    is_judged: bool
    """True if the recording is long enough to tell."""
    drift_ratio: float = math.nan
    """Held-out blind drift relative to what noise explains; NaN where there is no span, or no noise."""
    drift_deg: float = math.nan
    """Held-out blind drift, rms."""
    mounting: str = ''
    """Sensor that is mounted or wired wrongly, one of the contradictions; empty without."""
    unseen: str = ''
    """Why no image or heading tells where the gyro alone would have led, as a clause; empty where they do."""
    gaps: int = 0
    """Number of gaps of the gyro."""

    @property
    def fits(self) -> bool | None:
        """True or False; None if the recording cannot tell."""
        return False if self.misfits else (True if self.is_judged else None)


def model_fit(run: Run) -> ModelFit:
    """Compare innovations, scatter of the estimates and held-out blind drift with what noise explains."""
    scatter, _ = scatter_of(run)
    drift = blind_drift(run, from_s=held_out_from_s(run))
    by_noise_deg = drift_by_noise_deg(run, drift)
    is_judged = scatter.is_judged and len(drift.error_rad) > 0
    mounting, others = mounting_fault(run), _misfits(run, scatter, drift.rms_deg, by_noise_deg)
    misfits = tuple(filter(None, (mounting, *others)))
    ratio = drift.rms_deg / by_noise_deg if by_noise_deg else math.nan
    unseen, gaps = _why_unseen(run, drift), count_gaps(run.history)
    return ModelFit(misfits, is_judged, ratio, drift.rms_deg, mounting, unseen, gaps)


def count_gaps(history: History) -> int:
    """Return the number of gaps of the gyro, each of which lasts for one step of the filter or more."""
    lacks = history.gap_s > 0.0
    return int(np.count_nonzero(lacks & ~np.append(False, lacks[:-1])))


def _why_unseen(run: Run, drift: BlindDrift) -> str:
    end_s, last_s = float(run.history.time_s[-1]), max(float(last_seen_s(run.history)[-1]), 0.0)
    if last_s < MIN_SEEN_PART * end_s:
        return f'no image or heading is used after {last_s:.0f} of {end_s:.0f} s'
    return UNSEEN if drift.unseen > 0 and not len(drift.error_rad) else ''


def excess_nis(run: Run) -> float:
    """Return the sum of the NIS over a run less its degrees of freedom; about zero where the model fits."""
    return float((run.history.nis - run.history.dof).sum())


def _misfits(run: Run, scatter: Scatter, drift_deg: float, by_noise_deg: float) -> Iterator[str]:
    nis, limit = nis_per_dof(run.history.nis, run.history.dof), run.config.convergence.nis_high
    if nis is not None and nis > limit:
        yield f'the innovations are larger than expected (NIS {nis:.1f} per degree of freedom)'
    if loses_its_map(run):
        yield LOSES_MAPS
    changed_s = [
        seconds(event.t_ns - run.span.start_ns) for event in run.events if SCALE_CHANGED in event.text
    ]
    # Once, an earlier calibration may have been wrong, but not twice.
    is_followed_often = int(run.history.scale_followed.sum()) > MAX_FOLLOWED
    if is_followed_often or len(changed_s) > 1 or any(time_s > CALIBRATED_S for time_s in changed_s):
        yield 'the estimate of the scale factor changes within the recording'
    if scatter.contradicts:
        yield (
            'from stretch to stretch the estimates change by '
            f'{scatter.inflation.max():.0f} times what the filter expects'
        )
    if run.unfollowed_walk >= MUCH_WALK:
        yield walks_more(run.unfollowed_walk, 'at least ')
    if drift_deg > MAX_DRIFT_RATIO * by_noise_deg:
        yield (
            f'the heading drifts by {drift_deg:.2f} deg in {SPAN_S:.0f} s without the camera, of which noise '
            f'explains {by_noise_deg:.2f} deg'
        )
