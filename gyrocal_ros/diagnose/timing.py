"""Timing faults: the offset between the stamps of camera and IMU changes, or jitters, within a recording.

An error of dt in a stamp moves the heading that an image shows by rate times dt, and by nothing at rest. A
constant offset is an effect of the library, and a gyro lag looks the same. An offset that changes is neither:
no physics of the gyro changes it, but a clock that drifts and is set again does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gyrocal_ros.data import IntArray
from gyrocal_ros.diagnose.candidates import columns_of
from gyrocal_ros.diagnose.examined import ExaminedModel
from gyrocal_ros.diagnose.heading_filter import Headings, heading_log_likelihood
from gyrocal_ros.diagnose.model_fit import excess_nis
from gyrocal_ros.diagnose.noise_fit import fit_noises
from gyrocal_ros.diagnose.ranking import explained_together
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.score_statistics import BLOCK_S

TURNING_RAD_S, STRAIGHT_RAD_S = math.radians(20.0), math.radians(3.0)
"""Rates above and below which the innovations of turns and of straight lanes are compared."""
MIN_NIS_RATIO = 3.0
"""NIS in turns, relative to that on straight lanes, from which stamps may be at fault."""
MIN_CHANGE_S = 0.005
"""Range of the offsets of the blocks below which nothing has changed."""
MIN_STD = 0.3
"""Standard deviation of the offset, relative to that range, above which a block is not counted."""
CHANGES_PART, JITTERS_PART = 0.5, 0.2
"""Part of the excess of the NIS that an offset for each block explains if it changes slowly; and that
anything else may explain if it jitters from image to image."""
MARGIN = 1.05
"""Factor over the gain of all effects together that offsets of the blocks have to gain."""


@dataclass(frozen=True, slots=True)
class TimingFault:
    """An offset between the stamps of camera and IMU that is not constant."""

    kind: Literal['changes', 'jitters']
    low_s: float
    high_s: float
    """Lowest and highest offset over some seconds, stamps of the camera less those of the IMU."""
    std_s: float
    """Standard deviation from image to image, where it jitters; otherwise that between the blocks."""
    gain: float
    """Log-likelihood that knowing the offset of every block would gain; for jitter, the excess of the NIS."""
    is_allowed_for: bool = False
    """True if the filter has learned of it, so that effects can be judged beside; there is no gain then."""

    def __str__(self) -> str:
        if self.kind == 'jitters':
            return f'the stamps of the images, or of the IMU, jitter by about {1e3 * self.std_s:.0f} ms'
        return (
            'the offset between the stamps of camera and IMU changes within the recording, from '
            f'{1e3 * self.low_s:.0f} to {1e3 * self.high_s:.0f} ms'
        )


def stamp_jitter(run: Run) -> TimingFault | None:
    """Return the jitter of the stamps of images that the filter has learned, and allows for; None without."""
    std_s = float(run.history.stamp_noise_s[-1])
    return TimingFault('jitters', 0.0, 0.0, std_s, 0.0, is_allowed_for=True) if std_s > MIN_CHANGE_S else None


def timing_fault(examined: ExaminedModel) -> TimingFault | None:
    """Return the timing fault that explains a recording better than all effects do; None without.

    To first order an image that is late by dt has the innovation `G dt`, with the sensitivity G to the time
    offset. So `E[NIS - dof] = dt^2 G^T S^-1 G`, and the score statistics give dt for each block. Beside an
    offset that the model has there are none, so only jitter is judged, by the headings.
    """
    if not _shows_in_turns(examined):
        return None
    if any(effect.acts_on == 'time' for effect in examined.model.effects):
        known = explained_together(examined.ranked, examined.scores, examined.settings)
        return _jitter(examined, known, _heading_information(examined.seen), (0.0, 0.0))
    columns = _time_columns(examined)
    if len(columns) != 1:
        return None
    scores = examined.scores
    score = scores.score[:, columns[0]]
    information = scores.information[:, columns[0], columns[0]]
    excited = information > np.finfo(float).tiny
    score, information = score[excited], information[excited]
    if len(score) < 2:
        return None
    offsets_s, stds_s = score / information, 1.0 / np.sqrt(information)
    sharp = offsets_s[stds_s < MIN_STD * np.ptp(offsets_s)]
    gain = 0.5 * float(np.sum(score**2 / information))
    known = explained_together(examined.ranked, scores, examined.settings)
    spread = (float(sharp.min()), float(sharp.max())) if len(sharp) else (0.0, 0.0)
    excess = excess_nis(examined.run)
    if 2.0 * max(gain, known) < JITTERS_PART * excess:
        return _jitter(examined, max(gain, known), float(information.sum()), spread)
    price = examined.settings.coefficient_price * len(score)
    explains = gain - price > MARGIN * known and 2.0 * gain > CHANGES_PART * excess
    if not explains or spread[1] - spread[0] < MIN_CHANGE_S:
        return None
    return TimingFault('changes', *spread, float(np.std(sharp)), gain)


def _jitter(
    examined: ExaminedModel, explained: float, information: float, spread_s: tuple[float, float]
) -> TimingFault | None:
    """Return jitter that explains the excess of the NIS where little else does; None without.

    Args:
        examined: a model.
        explained: log-likelihood that anything else gains.
        information: about a constant offset, 1/s^2.
        spread_s: lowest and highest offset over some seconds.
    """
    excess = excess_nis(examined.run)
    if excess <= 0.0 or information <= 0.0 or 2.0 * explained >= JITTERS_PART * excess:
        return None
    std_s = math.sqrt(excess / information)
    is_jitter = std_s > MIN_CHANGE_S and _errs_by_image(examined, std_s)
    return TimingFault('jitters', *spread_s, std_s, 0.5 * excess) if is_jitter else None


def _heading_information(seen: Headings) -> float:
    """Return the information about a constant offset, 1/s^2, that the headings of the images contain."""
    is_seen = np.isfinite(seen.seen_rad)
    per_second = (seen.turn_rad / seen.dt_s)[is_seen] / seen.std_rad[is_seen]
    return float(np.sum(per_second**2))


def _time_columns(examined: ExaminedModel) -> IntArray:
    """Return the columns of the candidate effects that act on the time of an image."""
    effects = examined.scores.candidates
    found = [
        places
        for effect, places in zip(effects, columns_of(effects), strict=True)
        if effect.acts_on == 'time'
    ]
    return np.concatenate(found) if found else np.empty(0, np.int64)


def _errs_by_image(examined: ExaminedModel, std_s: float) -> bool:
    """Return True if jitter of the stamps makes the headings likelier than any noise of the gyro.

    An error of a stamp is gone with its image; an error of the gyro stays in the heading, and adds up.
    """
    seen = examined.seen
    jitter_rad = std_s * np.abs(seen.turn_rad / seen.dt_s)
    jittering = replace(seen, std_rad=np.hypot(seen.std_rad, jitter_rad))
    gain = heading_log_likelihood(jittering) - heading_log_likelihood(seen)
    return all(noise.gain < gain for noise in fit_noises(examined))


def _shows_in_turns(examined: ExaminedModel) -> bool:
    """Return True if the innovations are too large in turns, but not on straight lanes."""
    history = examined.run.history
    rate = np.abs(history.turn_rad / history.dt_s)
    parts = []
    for chosen in (rate > TURNING_RAD_S, rate < STRAIGHT_RAD_S):
        dof = float(history.dof[chosen].sum())
        if dof <= 0.0 or history.time_s[-1] < 2.0 * BLOCK_S:
            return False
        parts.append(float(history.nis[chosen].sum()) / dof)
    turning, straight = parts
    return turning > MIN_NIS_RATIO * max(straight, 1.0)
