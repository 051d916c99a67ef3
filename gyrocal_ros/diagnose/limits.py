"""Effects that enter by a limit: proposed by the readings, to be judged by a run of the filter.

Nothing depends smoothly on a limit, so there is no sensitivity to it. But readings pile up at the
largest one, or are one and the same number where a gyro should be noisy; and the heading tells whether
the turns were larger than that, or smaller.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.candidate_fit import Fit, fit
from gyrocal_ros.diagnose.candidates import with_means
from gyrocal_ros.diagnose.heading_filter import Headings, heading_scores
from gyrocal_ros.diagnose.recorded import Recorded
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.ekf.run import Run
from gyrocal_ros.ekf.state import YAW_BIAS
from gyrocal_ros.model.sensor import Effect

AT_THE_TOP = 0.99
"""Readings beyond this part of the largest one count as the pile."""
MIN_PILE_S = 0.5
"""How long readings have to stand at the largest one, all in all."""
STRAYS = 20
"""Largest readings that do not count: noise on top of a limit."""
BANDS_DEG_S = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Dead bands that are tried where noise hides the edge."""
MIN_GAIN = 40.0
"""Log-likelihood by the headings alone that makes a limit worth a run of the filter. A robot that
drives straight gains some by a dead band: it takes away the noise."""
ODD_PART, SATURATED_PART = 0.4, 0.5
"""Parts of what else explains the recording that a limit has to explain by the headings alone."""
NEARLY = 0.97
"""The widest band that explains nearly as much as the best: noise blurs its edge inwards."""
STUCK = 0.05
"""Share of the slow readings that are one and the same number where a band is dead."""
MAX_WANDER = 3.0
"""Readings that are dead vary from second to second no more than their noise, as a variance, lets expect."""
SHORT_S, SHORTS, FEW = 0.1, 10, 10
"""What noise is, is told by so short means, so many of which make a second; of few seconds nothing is."""
SLOW_RAD_S = math.radians(2.0)
GAP_STEPS = 3.0
"""A dead band ends where the next readings are so many times their usual distance away."""


def pile(recorded: Recorded) -> float | None:
    """Rate (rad/s) at which the largest readings pile up, if they do: a limit, or a habit."""
    size = np.abs(recorded.rate_rad_s)
    if len(size) <= STRAYS:
        return None
    top = AT_THE_TOP * float(np.partition(size, -STRAYS)[-STRAYS])
    rate_hz = NS_PER_S / float(np.median(np.diff(recorded.rate_t_ns)))
    at_the_top = size[size > top]
    return float(np.median(at_the_top)) if len(at_the_top) > STRAYS + MIN_PILE_S * rate_hz else None


def stuck(recorded: Recorded) -> float | None:
    """Width (rad/s) of the band around one value that is read again and again, where there is one.

    The readings of a coarse converter repeat too, but stand as far from each other everywhere.
    """
    slow = recorded.rate_rad_s[np.abs(recorded.rate_rad_s) < SLOW_RAD_S]
    values, counts = np.unique(slow, return_counts=True)
    if len(values) < 4:
        return None
    place = int(np.argmax(counts))
    if not 0 < place < len(values) - 1 or counts[place] < STUCK * counts.sum():
        return None
    gaps = np.diff(values)
    width = float(min(gaps[place - 1], gaps[place]))
    usual = float(np.median(np.delete(gaps, [place - 1, place])))
    return width if width > GAP_STEPS * usual else None


@dataclass(frozen=True, slots=True)
class LimitProposal:
    """A limit to judge by a run of the filter."""

    effect: Effect
    is_read: bool = False
    """Whether the readings themselves show it, so that no rival has to be beaten."""


def proposals(
    run: Run,
    seen: Headings,
    recorded: Recorded,
    odd_gain: float,
    rival_gain: float,
    has_jumped: bool = False,
) -> Iterator[LimitProposal]:
    """Limits that the readings suggest and the headings do not contradict.

    Args:
        run: of the filter without them.
        seen: its headings.
        recorded: the readings.
        odd_gain: what a free function of something recorded gains; a dead band whose edge is hidden
            by noise is proposed only where it explains a good part of that.
        rival_gain: what the best effect of another kind explains, zero where none is significant.
        has_jumped: whether what is odd is a jump of the bias, which no dead band makes.
    """
    present = {effect.name for effect in run.model.effects}
    if 'rate_saturation' not in present:
        limit = pile(recorded)
        if limit is not None and _may_saturate(run, seen, recorded, limit, odd_gain, rival_gain):
            yield LimitProposal(with_limit('rate_saturation', limit))
    if 'rate_deadband' not in present:
        width = stuck(recorded)
        is_read = width is not None
        if width is None and odd_gain > 0.0 and not has_jumped:
            width = _band(run, seen, recorded, max(MIN_GAIN, ODD_PART * max(odd_gain, rival_gain)))
        if width is not None:
            yield LimitProposal(with_limit('rate_deadband', width), is_read)


def with_limit(name: str, value: float) -> Effect:
    """The effect of that name, its limit known."""
    return with_means(EFFECTS[name], (value,))


def _may_saturate(
    run: Run, seen: Headings, recorded: Recorded, limit: float, odd_gain: float, rival_gain: float
) -> bool:
    """Whether a pile may be a limit: the robot turned further than its readings say.

    Beyond a limit the map itself goes astray, and the headings with it; then much is odd and nothing
    else explains it.
    """
    if rival_gain == 0.0 and odd_gain > 0.0:
        return True
    side = np.where(np.abs(recorded.rate_rad_s) >= AT_THE_TOP * limit, np.sign(recorded.rate_rad_s), 0.0)
    fitted = _beside_scale(run, seen, _over_steps(run, recorded, side))
    if fitted is None or float(fitted.values[0]) <= 0.0:
        return False
    return fitted.gain > max(MIN_GAIN, SATURATED_PART * rival_gain)


def _band(run: Run, seen: Headings, recorded: Recorded, least_gain: float) -> float | None:
    """Width of the band inside which the headings see neither bias nor turning, where that gains enough."""
    gains = {}
    for width in np.radians(BANDS_DEG_S).tolist():
        inside = (np.abs(recorded.rate_rad_s) < width).astype(float)
        scale = 1.0 + run.state.coefficients[0]
        by_bias = run.history.mean[:, YAW_BIAS] * _over_steps(run, recorded, inside)
        gone = -(scale * _over_steps(run, recorded, inside * recorded.rate_rad_s) + by_bias)
        fitted = _beside_scale(run, seen, gone)
        gains[width] = fitted.gain if fitted is not None else 0.0
    most = max(gains.values())
    widest = max(width for width in gains if gains[width] >= NEARLY * most)
    return widest if most > least_gain and _is_dead(recorded, widest) else None


def _is_dead(recorded: Recorded, width: float) -> bool:
    """Whether the readings inside a band follow nothing: neither a bias that changes nor slow turns."""
    count = max(round(SHORT_S * NS_PER_S / float(np.median(np.diff(recorded.rate_t_ns)))), 1)
    readings = recorded.rate_rad_s[: len(recorded.rate_rad_s) // (SHORTS * count) * SHORTS * count]
    seconds = readings.reshape(-1, SHORTS, count)
    inside = seconds[np.all(np.abs(seconds) < width, axis=(1, 2))].mean(axis=2)
    if len(inside) < FEW:
        return True
    noise = 0.5 * float(np.mean(np.diff(inside, axis=1) ** 2)) / SHORTS
    return float(np.var(inside.mean(axis=1))) <= MAX_WANDER * noise


def _beside_scale(run: Run, seen: Headings, error_rad_s: Array) -> Fit | None:
    """Fit an error of the rate (s,), with the scale free to give way."""
    rate = run.history.turn_rad / run.history.dt_s
    scores = heading_scores(seen, np.stack([error_rad_s, rate], axis=1))
    return fit(scores, np.array([0]), given=np.array([1]))


def _over_steps(run: Run, recorded: Recorded, values: Array) -> Array:
    """Mean (s,) over each step of the filter of something known at every reading."""
    t_ns = recorded.rate_t_ns
    t_s = (t_ns - t_ns[0]) / NS_PER_S
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s))])
    end_s = (run.history.t_ns - t_ns[0]) / NS_PER_S
    return (np.interp(end_s, t_s, total) - np.interp(end_s - run.history.dt_s, t_s, total)) / run.history.dt_s
