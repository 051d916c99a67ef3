"""Effects that enter by a limit: detected in the readings, confirmed by the headings, decided by a run.

Nothing depends smoothly on a limit, so there is no sensitivity to it. But readings pile up at a saturation
limit or are stuck at zero, and the headings show whether the turns were larger or smaller than read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from gyrocal_ros.data import NS_PER_S, Array
from gyrocal_ros.diagnose.analysis.candidate_fit import Fit, fit
from gyrocal_ros.diagnose.analysis.heading_filter import Headings, heading_scores
from gyrocal_ros.diagnose.settings import DiagnosisSettings
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import may_break_the_filter
from gyrocal_ros.ekf.history.run import Run
from gyrocal_ros.ekf.state.layout import YAW_BIAS
from gyrocal_ros.model.recording import GyroReadings
from gyrocal_ros.model.sensor import (
    DetectedLimit,
    Effect,
    LimitEffect,
    LimitOfEachSide,
    SensorModel,
    with_means,
)

MIN_LOST_S = 10.0
"""Minimum time for which a limit that noise hides loses the readings: less does not show that it does."""


@dataclass(frozen=True, slots=True)
class LimitProposal:
    """A limit to be decided by a run of the filter."""

    effect: Effect
    is_certain: bool = False
    """True if the readings themselves prove it, so that it need not beat other effects."""


@dataclass(frozen=True, slots=True)
class Competition:
    """Other explanations of the recording that a limit is proposed for."""

    lacks_something: bool
    """True if structure is unexplained, or another effect gains, evenly or not."""
    contradicts: bool = False
    """True if the recording contradicts the model, whatever it lacks."""
    has_jumped: bool = False
    """True if the unexplained structure is a jump of the bias, which no limit causes."""


def propose_limits(
    run: Run, seen: Headings, readings: GyroReadings, others: Competition, settings: DiagnosisSettings
) -> Iterator[LimitProposal]:
    """Propose limits that the readings suggest and the headings do not contradict.

    Args:
        run: a run of the filter without them.
        seen: its headings.
        readings: raw readings of the yaw rate.
        others: what else explains the recording.
        settings: thresholds.
    """
    for effect in _missing_limits(run.model):
        uneven = _of_each_side(effect, readings)
        if uneven is not None:
            limit = uneven.coefficients[0].prior_mean
            if _is_confirmed(uneven, limit, run, seen, readings, others, settings):
                yield LimitProposal(uneven)
        found = effect.detect(readings)  # type: ignore[attr-defined]
        if found is None:
            value = _hidden_by_noise(effect, run, seen, readings, others, settings)
            if value is not None:
                yield LimitProposal(with_means(effect, (value,)))
        elif found.is_certain or _is_confirmed(effect, found.value, run, seen, readings, others, settings):
            yield LimitProposal(with_means(effect, (found.value,)), found.is_certain)


def proven_limits(model: SensorModel, readings: GyroReadings) -> list[Effect]:
    """Return the limits that the readings prove and the model lacks, whether they matter or not."""
    found = _detected(_missing_limits(model), readings)
    return [with_means(effect, (limit.value,)) for effect, limit in found if limit.is_certain]


def detected_limits(model: SensorModel, readings: GyroReadings) -> list[Effect]:
    """Return the limits, of those that may break the filter and the model lacks, that the readings show."""
    breaking = [effect for effect in _missing_limits(model) if may_break_the_filter(effect)]
    even = [with_means(effect, (limit.value,)) for effect, limit in _detected(breaking, readings)]
    return [*filter(None, (_of_each_side(effect, readings) for effect in breaking)), *even]


def _detected(limits: Iterable[Effect], readings: GyroReadings) -> Iterator[tuple[Effect, DetectedLimit]]:
    """Yield the limits that the readings show, and their sizes."""
    for effect in limits:
        found = effect.detect(readings)  # type: ignore[attr-defined]
        if found is not None:
            yield effect, found


def _of_each_side(effect: Effect, readings: GyroReadings) -> Effect | None:
    """Return a limit with another value to each side, if the readings show one.

    The usual rate of the turns to one side looks like a limit as well: runs with each decide.
    """
    return effect.of_each_side(readings) if isinstance(effect, LimitOfEachSide) else None


def _missing_limits(model: SensorModel) -> list[Effect]:
    present = {effect.name for effect in model.effects}
    return [item for item in EFFECTS.values() if isinstance(item, LimitEffect) and item.name not in present]


def _is_confirmed(
    effect: Effect,
    limit: float,
    run: Run,
    seen: Headings,
    readings: GyroReadings,
    others: Competition,
    settings: DiagnosisSettings,
) -> bool:
    """Return True if the wheels and the headings confirm a limit, so that a run has to decide.

    Both have to turn faster than the readings at the limit, where there are wheels. A limit that may break
    the filter spoils the map, and the headings with it: where the recording contradicts the model, the
    headings are no test. Neither are those of a reference: what the gyro loses passes for a jump of it.
    """
    error = _rate_error(effect, limit, run, readings)
    if may_break_the_filter(effect):
        if not _wheels_turn_further(run, error, settings.limit_wheel_part * limit):
            return False
        if others.contradicts or run.rig.camera is None:
            return True
    fitted = _fit_beside_scale(run, seen, error)
    return fitted is not None and float(fitted.values[0]) > 0.0 and fitted.gain > settings.limit_heading_gain


def _wheels_turn_further(run: Run, error_rad_s: Array, least_rad_s: float) -> bool:
    """Return True if the wheels turn faster, relative to the gyro, where an error (s,) is suspected.

    A robot without wheels, or one that is turned by hand, says nothing against it.
    """
    history = run.history
    if not history.wheel_turn_rad.any():
        return True
    columns = np.stack([error_rad_s, history.turn_rad / history.dt_s, np.ones_like(error_rad_s)], axis=1)
    values = np.linalg.lstsq(columns, history.wheel_turn_rad / history.dt_s, rcond=None)[0]
    return bool(values[0] > least_rad_s)


def _hidden_by_noise(
    effect: Effect,
    run: Run,
    seen: Headings,
    readings: GyroReadings,
    others: Competition,
    settings: DiagnosisSettings,
) -> float | None:
    """Return a limit of those in the effect's scan that the headings suggest and the readings allow, or None.

    A run decides about its size.
    """
    if not others.lacks_something or others.has_jumped:
        return None
    scan = [size for size in effect.coefficients[0].scan if _lost_s(effect, size, run, readings) > MIN_LOST_S]
    gains = np.array([_gain_with_bias(effect, limit, run, seen, readings) for limit in scan])
    if gains.max(initial=0.0) <= settings.limit_heading_gain:
        return None
    best_first = (scan[place] for place in np.argsort(-gains))
    return next((size for size in best_first if effect.is_plausible(readings, size)), None)  # type: ignore[attr-defined]


def _lost_s(effect: Effect, limit: float, run: Run, readings: GyroReadings) -> float:
    """Return the time of the steps in which most readings hold no bias."""
    _, bias_part = effect.rate_error(readings.rate_rad_s, limit)  # type: ignore[attr-defined]
    is_lost = _mean_over_steps(run, readings, bias_part) < -0.5
    return float(run.history.dt_s[is_lost].sum())


def _rate_error(effect: Effect, limit: float, run: Run, readings: GyroReadings) -> Array:
    """Return the rate error (s,) of each step of a filter that lacks a limit which is there."""
    lost, bias_part = effect.rate_error(readings.rate_rad_s, limit)  # type: ignore[attr-defined]
    scale = 1.0 + run.state.coefficients[0]
    by_bias = run.history.mean[:, YAW_BIAS] * _mean_over_steps(run, readings, bias_part)
    return scale * _mean_over_steps(run, readings, lost) + by_bias


def _gain_with_bias(effect: Effect, limit: float, run: Run, seen: Headings, readings: GyroReadings) -> float:
    """Return the gain of what a limit loses, and of a bias that shows outside of it alone.

    The readings inside say that there is no bias, so the filter lacks it in turns. That alone looks like an
    uneven scale factor.
    """
    _, bias_part = effect.rate_error(readings.rate_rad_s, limit)  # type: ignore[attr-defined]
    outside = 1.0 + _mean_over_steps(run, readings, bias_part)
    fitted = _fit_beside_scale(run, seen, _rate_error(effect, limit, run, readings), outside)
    return fitted.gain if fitted is not None else 0.0


def _fit_beside_scale(run: Run, seen: Headings, *errors_rad_s: Array) -> Fit | None:
    """Fit errors of the rate, (s,) each, together with an error of the scale factor."""
    rate = run.history.turn_rad / run.history.dt_s
    scores = heading_scores(seen, np.stack([*errors_rad_s, rate], axis=1))
    count = len(errors_rad_s)
    return fit(scores, np.arange(count), given=np.array([count]))


def _mean_over_steps(run: Run, readings: GyroReadings, values: Array) -> Array:
    """Return the mean (s,) over each step of the filter of values (n,) known at every reading."""
    t_ns = readings.t_ns
    t_s = (t_ns - t_ns[0]) / NS_PER_S
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s))])
    end_s = (run.history.t_ns - t_ns[0]) / NS_PER_S
    return (np.interp(end_s, t_s, total) - np.interp(end_s - run.history.dt_s, t_s, total)) / run.history.dt_s
