"""Whether the model fits a recording, whatever it may lack."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import Array, seconds
from gyrocal_ros.diagnose.analysis.drift import (
    SPAN_S,
    BlindDrift,
    blind_drift,
    held_out_from_s,
    last_seen_s,
)
from gyrocal_ros.ekf.history.run import History, Run
from gyrocal_ros.ekf.history.scatter import Scatter, scatter_of
from gyrocal_ros.ekf.history.turn_agreement import mounting_fault
from gyrocal_ros.ekf.map_watch import LOSES_MAPS, loses_its_map
from gyrocal_ros.ekf.noise.noise_bank import MUCH_WALK, walks_more
from gyrocal_ros.ekf.noise.process_noise import yaw_noise_of
from gyrocal_ros.ekf.state.layout import COEFFICIENTS_START, YAW, YAW_BIAS
from gyrocal_ros.ekf.watches.scale_watch import SCALE_CHANGED
from gyrocal_ros.model.sensor import MovesAgainstBody
from gyrocal_ros.statistics import nis_per_dof

CALIBRATED_S = 60.0
"""Time after which a change of the scale factor is none of an earlier calibration that was wrong."""
MAX_FOLLOWED = 3
"""Largest number of changes that a run follows, whatever was known of the scale factor before."""
MAX_DRIFT_RATIO = 4.0
"""Largest blind drift, relative to what noise explains, of a model that fits."""
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


def drift_by_noise_deg(run: Run, drift: BlindDrift) -> float:
    """Return the rms blind drift that noise explains; NaN where there is no span.

    It adds the headings at both ends, the white noise and the bias walk of the gyro, turns that it could not
    read, the uncertainty of bias and coefficients at the beginning of each span, and turns of the camera
    against the robot. A bias that walks by more than the settings say is no such noise: an effect may be
    behind it.
    """
    history = run.history
    noise = yaw_noise_of(run.model, run.config.gyro, history.turn_rad / history.dt_s)
    moving = history.resting == 0
    first = np.searchsorted(history.time_s, drift.start_s)
    last = np.searchsorted(history.time_s, drift.start_s + drift.span_s)
    valid_s = np.cumsum(np.where(moving, history.gyro_valid_s, 0.0))
    columns = np.cumsum(np.where(moving[:, None], history.columns, 0.0), axis=0)
    span_s = valid_s[last] - valid_s[first]
    variance = history.std[first, YAW] ** 2 + history.std[last, YAW] ** 2
    white = np.cumsum(np.where(moving, noise.density_rad_s**2 * history.gyro_valid_s, 0.0))
    variance += white[last] - white[first]
    unread = np.cumsum(_unread_variance(np.where(moving, history.unobserved_turn_std_rad, 0.0)))
    variance += unread[last] - unread[first]
    variance += noise.bias_walk_rad_s**2 * span_s**3 / 3.0
    bias_std = history.std[:, YAW_BIAS]
    if (history.bias_walk > 1.0).any():
        bias_std = np.minimum.accumulate(bias_std)
    variance += (bias_std[first] * span_s) ** 2
    by_coefficients = (columns[last] - columns[first]) * history.std[first, COEFFICIENTS_START:]
    variance += np.sum(by_coefficients**2, axis=1) + turn_against_body_rad(run) ** 2
    return float(np.degrees(np.sqrt(np.mean(variance)))) if len(variance) else math.nan


def turn_against_body_rad(run: Run) -> float:
    """Return by how much the camera may turn against the robot, by the effects in the model.

    The heading of the map is that of the camera, and where it lies in its play is not known exactly.
    """
    ends = np.cumsum([len(effect.coefficients) for effect in run.model.effects])
    parts = np.split(run.state.coefficients, ends[:-1])
    pairs = zip(run.model.effects, parts, strict=True)
    moved = [item.turn_against_body_rad(part) for item, part in pairs if isinstance(item, MovesAgainstBody)]
    return float(sum(moved))


def _unread_variance(unread_rad: Array) -> Array:
    """Return the variance (s,) of turns whose error (s,) is one and the same from step to step.

    It is counted at the last step of each stretch of them.
    """
    total_rad, is_unread = np.cumsum(unread_rad), unread_rad > 0.0
    ends = np.flatnonzero(is_unread & ~np.append(is_unread[1:], False))
    variance = np.zeros_like(unread_rad)
    variance[ends] = np.diff(total_rad[ends], prepend=0.0) ** 2
    return variance


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
