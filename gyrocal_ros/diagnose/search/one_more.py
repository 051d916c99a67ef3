"""Runs of the filter with one more effect.

The filter is linear in the strength of an effect, not in a time constant: with both unknown, each can lead
the other astray, and neither finds back. So runs with known time constants decide between these, and between
the forms of an effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, gain_of_run, wider_model
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.search.additions import Addition, addition
from gyrocal_ros.effects.traits import forms_of, scanned_coefficient
from gyrocal_ros.errors import CANNOT_RUN, FilterDivergedError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel

STEP = 1.25
"""Ratio of two time constants that are tried."""
MAX_STEPS = 4
"""Largest number of steps from the estimate by the score statistics."""
KNOWN_PART = 1e-3
"""Prior standard deviation of a known time constant, as a part of it."""
LEAST_PART = 0.1
"""Smallest prior standard deviation of the one that was found, as a part of it."""


def with_one_more(
    present: ExaminedModel, effect: Effect, recording: RecordingSummary, calibrate: Calibrate
) -> Addition:
    """Run the filter with one more effect, which starts at its estimate by the score statistics.

    Args:
        present: the model so far.
        effect: the effect.
        recording: summary of the recording.
        calibrate: runs the filter.

    Raises:
        FilterDivergedError: the filter cannot run with it.
    """
    wider, place, settings = wider_model(present, effect), scanned_coefficient(effect), present.settings
    found = present.find(effect.name)
    if place is None or found is None:
        return addition(present, examine(wider, recording, calibrate, settings))
    if found.merit <= settings.uneven_view_gain:
        # Slow errors of images gain that much. They have no time constant: a run that is free to says so.
        with suppress(FilterDivergedError):
            return addition(present, examine(wider, recording, calibrate, settings))
    likeliest = _from_likeliest(wider, place, present, calibrate)
    return addition(present, examine(likeliest, recording, calibrate, settings))


def each_one_more(
    present: ExaminedModel, effects: Iterable[Effect], recording: RecordingSummary, calibrate: Calibrate
) -> list[Addition]:
    """Run the filter with one more effect, for each of some; those with which it cannot run are left out."""

    def added(effect: Effect) -> Addition | None:
        with suppress(*CANNOT_RUN):
            return with_one_more(present, effect, recording, calibrate)
        return None

    tried = side_by_side(calibrate, [partial(added, effect) for effect in effects])
    return [item for item in tried if item is not None]


def _from_likeliest(
    wider: SensorModel, place: int, present: ExaminedModel, calibrate: Calibrate
) -> SensorModel:
    """Return the model whose last effect has the form, and starts at the time constant, that predict best.

    Args:
        wider: the model with the effect, which starts at its estimate by the score statistics.
        place: index of its time constant among its coefficients.
        present: the model without.
        calibrate: runs the filter.
    """
    *others, last = wider.effects
    item = last.coefficients[place]
    models = [replace(wider, effects=(*others, form)) for form in forms_of(last)]

    @cache
    def gain(form: int, step: int) -> float:
        value = item.prior_mean * STEP**step
        return gain_of_run(present, _starting(models[form], place, value, KNOWN_PART * value), calibrate)

    gains = side_by_side(calibrate, [partial(gain, form, 0) for form in range(len(models))])
    form = gains.index(max(gains))
    side_by_side(calibrate, [partial(gain, form, step) for step in (-1, 1)])
    step, std = _maximum(partial(gain, form))
    if not math.isfinite(step):
        return wider
    value = item.prior_mean * STEP**step
    part = max(LEAST_PART, 2.0 * std * math.log(STEP))
    return _starting(models[form], place, value, min(part * value, item.prior_std))


def _maximum(gain: Callable[[int], float]) -> tuple[float, float]:
    """Return where a log-likelihood is largest, climbing from zero, and its standard deviation there.

    NaN where it is minus infinity all about; the standard deviation is 0 at an end.
    """
    best = way = max((0, -1, 1), key=gain)
    while 0 < abs(best) < MAX_STEPS and gain(best + way) > gain(best):
        best += way
    if not math.isfinite(gain(best)):
        return math.nan, math.nan
    before, after = gain(best - 1), gain(best + 1)
    curvature = 2.0 * gain(best) - before - after
    if not 0.0 < curvature < math.inf:
        return best, 0.0
    return best + 0.5 * (after - before) / curvature, 1.0 / math.sqrt(curvature)


def _starting(model: SensorModel, place: int, value: float, std: float) -> SensorModel:
    """Return the model with another prior of one coefficient of its last effect."""
    *others, last = model.effects
    items = list(last.coefficients)
    items[place] = replace(items[place], prior_mean=value, prior_std=std)
    return replace(model, effects=(*others, replace(last, coefficients=tuple(items))))  # type: ignore[type-var]
