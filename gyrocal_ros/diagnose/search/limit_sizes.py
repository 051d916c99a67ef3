"""Sizes of limits that noise hides in the readings: a run decides, again once something else is found."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import itemgetter

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, gain_of_run, with_effect
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
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
    for limit in [item for item in present.model.effects if item.name in names]:
        own = limit.coefficients[0].prior_mean
        sizes = [size for size in possible_sizes(limit, recording.readings) if size != own]
        sized, gain = best_size(present, limit, sizes, calibrate)
        if gain > present.settings.min_predictive_gain:
            with suppress(*CANNOT_RUN):
                present = examine(_with_limit(present.model, sized), recording, calibrate, present.settings)
    return present


def possible_sizes(limit: Effect, readings: GyroReadings) -> list[float]:
    """Return the sizes that the readings allow: those of a scan where noise hides the limit, else its own."""
    assert isinstance(limit, LimitEffect)
    scan = limit.coefficients[0].scan
    if not scan or limit.detect(readings) is not None:
        return [limit.coefficients[0].prior_mean]
    return [size for size in scan if limit.is_plausible(readings, size)]


def best_size(
    present: ExaminedModel, limit: Effect, sizes: Sequence[float], calibrate: Calibrate
) -> tuple[Effect, float]:
    """Return a limit with the size with which a run predicts best, and what the run gains.

    Args:
        present: the model without the limit, or with another size of it.
        limit: the limit.
        sizes: sizes to try.
        calibrate: runs the filter.

    Returns:
        The limit, and the predictive log-likelihood that it gains; minus infinity where no run is possible.
    """
    limits = [with_means(limit, (size,)) for size in sizes]
    models = [_with_limit(present.model, item) for item in limits]
    gains = side_by_side(calibrate, [partial(gain_of_run, present, model, calibrate) for model in models])
    return max(zip(limits, gains, strict=True), key=itemgetter(1), default=(limit, -math.inf))


def _with_limit(model: SensorModel, limit: Effect) -> SensorModel:
    """Return the model with a limit, in the place of one of the same name."""
    if all(item.name != limit.name for item in model.effects):
        return with_effect(model, limit)
    return replace(model, effects=tuple(limit if item.name == limit.name else item for item in model.effects))
