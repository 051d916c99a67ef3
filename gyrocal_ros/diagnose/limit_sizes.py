"""Sizes of limits that noise hides in the readings: fitted again beside what was found since."""

from __future__ import annotations

import math
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace

from gyrocal_ros.diagnose.examined import Calibrate, ExaminedModel, examine
from gyrocal_ros.diagnose.predictive_gain import predictive_gain
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import GyroReadings, RecordingSummary
from gyrocal_ros.model.sensor import Effect, LimitEffect, SensorModel, with_means


def resized(
    present: ExaminedModel, names: Collection[str], recording: RecordingSummary, calibrate: Calibrate
) -> ExaminedModel:
    """Return a model in which limits have the sizes with which a run predicts best.

    The filter does not estimate a limit. While something else is missing, the size of one that noise hides
    makes up for that, too, and what it gets wrong looks like further effects.

    Args:
        present: the model.
        names: names of the limits; those whose size the readings show stay as they are.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    limits = [item for item in present.model.effects if item.name in names]
    for limit in (item for item in limits if _is_hidden(item, recording.readings)):
        sizes = [
            size for size in limit.coefficients[0].scan if _is_plausible(limit, size, recording.readings)
        ]
        models = [_with_size(present.model, limit, size) for size in sizes]
        gains = [_gain(present, model, calibrate) for model in models]
        if max(gains, default=-math.inf) > present.settings.min_predictive_gain:
            with suppress(*CANNOT_RUN):
                best = models[gains.index(max(gains))]
                present = examine(best, recording, calibrate, present.settings)
    return present


def _is_hidden(effect: Effect, readings: GyroReadings) -> bool:
    """Return True for a limit whose size is one of a scan, for the readings do not show it."""
    return (
        isinstance(effect, LimitEffect)
        and bool(effect.coefficients[0].scan)
        and effect.detect(readings) is None
    )


def _is_plausible(limit: Effect, size: float, readings: GyroReadings) -> bool:
    assert isinstance(limit, LimitEffect)
    return limit.coefficients[0].prior_mean != size and limit.is_plausible(readings, size)


def _with_size(model: SensorModel, limit: Effect, size: float) -> SensorModel:
    effects = (with_means(item, (size,)) if item is limit else item for item in model.effects)
    return replace(model, effects=tuple(effects))


def _gain(present: ExaminedModel, model: SensorModel, calibrate: Calibrate) -> float:
    with suppress(*CANNOT_RUN):
        return float(predictive_gain(present.run, calibrate(model, ())).sum())
    return -math.inf
