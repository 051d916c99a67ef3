"""Timing faults: the offset between the stamps of camera and IMU changes, or jitters, within a recording.

An error of dt in a stamp moves the heading that an image shows by rate times dt, and by nothing at rest. A
constant offset is an effect of the library, and a gyro lag looks the same. An offset that changes with time
is neither: no physics of the gyro changes it, but a clock that drifts and is set again does. One that follows
the rate is no matter of clocks: a gyro whose slew is limited, or whose filter adapts, lags by more in fast
turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gyrocal_ros.data import Array, IntArray
from gyrocal_ros.diagnose.analysis.candidates import columns_of
from gyrocal_ros.diagnose.analysis.drift import blind_drift, drift_by_noise_deg, held_out_from_s
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, heading_log_likelihood
from gyrocal_ros.diagnose.analysis.model_fit import excess_nis
from gyrocal_ros.diagnose.analysis.ranking import explained_together
from gyrocal_ros.diagnose.search.noise_fit import fit_noises
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.history.score_statistics import BLOCK_S, ScoreStatistics

TURNING_RAD_S, STRAIGHT_RAD_S = math.radians(20.0), math.radians(3.0)
"""Rates above and below which the innovations of turns and of straight lanes are compared."""
CHANGES_NIS_RATIO, JITTERS_NIS_RATIO = 1.2, 3.0
"""NIS in turns, relative to that on straight lanes, from which the offset of the stamps may change, and from
which they may jitter."""
MIN_CHANGE_S = 0.005
"""Range of the offsets of the blocks below which nothing has changed."""
MIN_STD = 0.3
"""Standard deviation of the offset, relative to that range, above which a block is not counted."""
CHANGES_PART, JITTERS_PART = 0.72, 0.2
"""Part of the excess of the NIS that an offset for each block explains if it changes slowly, of which a loose
camera leaves more; and that anything else may explain if it jitters from image to image."""
MARGIN = 1.05
"""Factor over the gain of all effects together that offsets of the blocks have to gain."""
DRIFT_BLOCKS, DRIFT_SCATTER, DRIFTS_PART = 6, 0.1, 0.8
"""Number of blocks, scatter of their offsets about a line over time relative to its range, and part of the
excess of the NIS that it has to explain, from which two clocks run apart. The line tells that by itself: the
innovations of turns may be little larger than those of straight lanes, or all be large."""
RATE_PART = 0.75
"""Part of what the offsets of the blocks gain over a constant one, from which a line over the rate explains
them."""
TINY = np.finfo(float).tiny
FURTHER = 1.5
"""Drift, relative to the turn within the range of the offsets and to noise, that stamps do not make."""
END_PART = 0.05
"""Part of the weight of the blocks, at either end, that says nothing of the range of their offsets."""
ROUGH_S = 0.001
"""Standard deviation of a line over the offsets of blocks; blocks that are sharper count alike."""


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
    drift_ppm: float = 0.0
    """Rate at which the offset grows steadily; 0 if it does not."""
    is_allowed_for: bool = False
    """True if the filter has learned of it, so that effects can be judged beside; there is no gain then."""

    def __str__(self) -> str:
        if self.kind == 'jitters':
            return f'the stamps of the images, or of the IMU, jitter by about {1e3 * self.std_s:.0f} ms'
        clocks = f': their clocks run apart by {abs(self.drift_ppm):.0f} ppm' if self.drift_ppm else ''
        return (
            'the offset between the stamps of camera and IMU changes within the recording, from '
            f'{1e3 * self.low_s:.0f} to {1e3 * self.high_s:.0f} ms{clocks}'
        )


@dataclass(frozen=True, slots=True, eq=False)
class _BlockOffsets:
    """Offset of each of b blocks that say something of it."""

    time_s: Array
    score: Array
    information: Array
    """(b,) times, scores and information, 1/s^2."""

    @property
    def values_s(self) -> Array:
        """Return the offsets (b,)."""
        return self.score / self.information

    @property
    def stds_s(self) -> Array:
        """Return their standard deviations (b,)."""
        return 1.0 / np.sqrt(self.information)

    def gain(self, offsets_s: Array) -> float:
        """Return the log-likelihood that offsets (b,) gain."""
        return float(offsets_s @ self.score - 0.5 * offsets_s**2 @ self.information)


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
    has_offset = any(effect.acts_on == 'time' for effect in examined.model.effects)
    columns = _time_columns(examined)
    blocks = None if has_offset or len(columns) != 1 else _block_offsets(examined.scores, columns[0])
    drift = None if blocks is None else _drift(blocks, excess_nis(examined.run))
    nis_ratio = _nis_ratio_of_turns(examined)
    if drift is None and nis_ratio < CHANGES_NIS_RATIO:
        return None
    known = explained_together(examined.ranked, examined.scores, examined.settings)
    if drift is not None and drift.gain - 2.0 * examined.settings.coefficient_price > MARGIN * known:
        return drift
    may_jitter = nis_ratio > JITTERS_NIS_RATIO
    if has_offset:
        information = _heading_information(examined.seen)
        return _jitter(examined, known, information, (0.0, 0.0)) if may_jitter else None
    if blocks is None or nis_ratio < CHANGES_NIS_RATIO:
        return None
    return _changing(examined, blocks, known, may_jitter=may_jitter)


def _changing(
    examined: ExaminedModel, blocks: _BlockOffsets, known: float, *, may_jitter: bool
) -> TimingFault | None:
    """Return an offset that changes from block to block, or jitter where not even that explains much.

    Args:
        examined: a model.
        blocks: offset of each block.
        known: log-likelihood that all effects together gain.
        may_jitter: True if the innovations are far larger in turns.
    """
    excess, price = excess_nis(examined.run), examined.settings.coefficient_price * len(blocks.time_s)
    is_sharp = blocks.stds_s < MIN_STD * np.ptp(blocks.values_s)
    sharp, gain = blocks.values_s[is_sharp], blocks.gain(blocks.values_s)
    spread = _range(sharp, blocks.stds_s[is_sharp])
    if may_jitter and 2.0 * max(gain, known) < JITTERS_PART * excess:
        return _jitter(examined, max(gain, known), float(blocks.information.sum()), spread)
    explains = gain - price > max(MARGIN * known, _gain_of_structure(examined))
    explains = explains and 2.0 * gain > CHANGES_PART * excess
    if not explains or spread[1] - spread[0] < MIN_CHANGE_S or _follow_the_rate(blocks, examined.run):
        return None
    if _drifts_further(examined.run, spread[1] - spread[0]):
        return None
    return TimingFault('changes', *spread, float(np.std(sharp)), gain)


def _range(values_s: Array, stds_s: Array) -> tuple[float, float]:
    """Return the range of the offsets (b,) of blocks, without the few of either end: turns may err alike."""
    if not len(values_s):
        return 0.0, 0.0
    order = np.argsort(values_s)
    weight = np.cumsum(1.0 / (stds_s[order] ** 2 + ROUGH_S**2))
    low, high = np.searchsorted(weight, np.array([END_PART, 1.0 - END_PART]) * weight[-1])
    return float(values_s[order[low]]), float(values_s[order[high]])


def _gain_of_structure(examined: ExaminedModel) -> float:
    """Return the log-likelihood that the headings gain by a law of the gyro; wrong stamps bend none."""
    structure = examined.unexplained_structure
    return 0.0 if structure is None else structure.gain


def _drifts_further(run: Run, range_s: float) -> bool:
    """Return True if the robot drifts further without the camera than such a range of offsets explains.

    A wrong stamp shifts the heading that an image shows; it is no error of the gyro, which adds up.
    """
    fastest_deg_s = math.degrees(float(np.max(np.abs(run.history.turn_rad / run.history.dt_s))))
    drift = blind_drift(run, from_s=held_out_from_s(run))
    explained_deg = fastest_deg_s * range_s + drift_by_noise_deg(run, drift)
    return drift.rms_deg > FURTHER * explained_deg


def _follow_the_rate(blocks: _BlockOffsets, run: Run) -> bool:
    """Return True if a line over the rate explains most of how the offsets differ from block to block."""
    if len(blocks.time_s) < DRIFT_BLOCKS:
        return False
    rates_rad_s = _turning_rates(blocks.time_s, run)
    line_s = np.polyval(np.polyfit(rates_rad_s, blocks.values_s, 1, w=1.0 / blocks.stds_s), rates_rad_s)
    mean_s = np.full_like(line_s, np.average(blocks.values_s, weights=blocks.information))
    least, gain, most = (blocks.gain(offsets_s) for offsets_s in (mean_s, line_s, blocks.values_s))
    return gain - least > RATE_PART * (most - least)


def _turning_rates(start_s: Array, run: Run) -> Array:
    """Return the mean magnitude (b,) of the rate in blocks that begin at times (b,), weighted by its square.

    That is the weight of each moment in the offset of a block.
    """
    history = run.history
    rate = np.abs(history.turn_rad / history.dt_s)
    first, last = (np.searchsorted(history.time_s, start_s + after_s) for after_s in (0.0, BLOCK_S))
    cubes, squares = (np.append(0.0, np.cumsum(rate**power * history.dt_s)) for power in (3, 2))
    rates: Array = (cubes[last] - cubes[first]) / np.maximum(squares[last] - squares[first], TINY)
    return rates


def _block_offsets(scores: ScoreStatistics, column: int) -> _BlockOffsets | None:
    """Return the offset of each block by the statistics of the time offset; None for a single block."""
    score, information = scores.score[:, column], scores.information[:, column, column]
    excited = information > TINY
    if np.count_nonzero(excited) < 2:
        return None
    return _BlockOffsets(scores.start_s[excited], score[excited], information[excited])


def _drift(blocks: _BlockOffsets, excess: float) -> TimingFault | None:
    """Return an offset that grows steadily, as of two clocks that are not synchronised; None without.

    Args:
        blocks: offset of each block.
        excess: excess of the NIS, most of which it has to explain.
    """
    sharp = blocks.stds_s < MIN_STD * np.ptp(blocks.values_s)
    if np.count_nonzero(sharp) < DRIFT_BLOCKS:
        return None
    time_s, values_s = blocks.time_s[sharp], blocks.values_s[sharp]
    weights = 1.0 / np.hypot(blocks.stds_s[sharp], ROUGH_S)
    slope, start_s = np.polyfit(time_s, values_s, 1, w=weights)
    line_s = start_s + slope * blocks.time_s
    left_s = values_s - line_s[sharp]
    grown_s, scatter_s = abs(slope) * np.ptp(time_s), math.sqrt(np.average(left_s**2, weights=weights**2))
    gain = blocks.gain(line_s)
    is_line = grown_s > MIN_CHANGE_S and scatter_s < DRIFT_SCATTER * grown_s
    if not is_line or 2.0 * gain < DRIFTS_PART * excess:
        return None
    low_s, high_s = (float(line_s[sharp][place]) for place in ((0, -1) if slope > 0.0 else (-1, 0)))
    return TimingFault('changes', low_s, high_s, scatter_s, gain, drift_ppm=1e6 * float(slope))


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


def _nis_ratio_of_turns(examined: ExaminedModel) -> float:
    """Return the NIS in turns relative to that on straight lanes; 0 where one of them is not known."""
    history = examined.run.history
    rate = np.abs(history.turn_rad / history.dt_s)
    parts = []
    for chosen in (rate > TURNING_RAD_S, rate < STRAIGHT_RAD_S):
        dof = float(history.dof[chosen].sum())
        if dof <= 0.0 or history.time_s[-1] < 2.0 * BLOCK_S:
            return 0.0
        parts.append(float(history.nis[chosen].sum()) / dof)
    turning, straight = parts
    return turning / max(straight, 1.0)
