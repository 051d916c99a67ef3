"""Recovery of a filter that diverges because the model lacks an effect."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from functools import partial

import numpy as np

from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, with_effect
from gyrocal_ros.diagnose.analysis.late_images import late_images
from gyrocal_ros.diagnose.analysis.limits import detected_limits
from gyrocal_ros.diagnose.analysis.runs import Calibrate, side_by_side
from gyrocal_ros.diagnose.search.additions import Addition
from gyrocal_ros.diagnose.settings import DEFAULT_SETTINGS, DiagnosisSettings
from gyrocal_ros.effects import EFFECTS
from gyrocal_ros.effects.traits import (
    has_impossible_sign,
    is_bias_walk,
    is_limit,
    is_unusual,
    may_break_the_filter,
    strengths,
)
from gyrocal_ros.errors import CANNOT_RUN, FilterDivergedError
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Effect, SensorModel, with_means
from gyrocal_ros.statistics import nis_per_dof

BROKEN_NIS, MENDED_PART = 100.0, 0.1
"""NIS per degree of freedom of a run that is as good as diverged: innovations of ten standard deviations.
What breaks it has to leave less than this part of it."""
STRIDE = 3
"""Distance of the sizes of a walk of the bias that are tried."""


def first_run(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
) -> tuple[ExaminedModel, list[Addition]]:
    """Return the run with a model, or with the effect whose absence breaks the filter, and that effect.

    Images that are far too late or too early break it in any case; the model then needs the offset. So does a
    lag of the gyro, where a reference is exact enough to show it.

    Raises:
        FilterDivergedError: the filter cannot run with this model, nor with such an effect.
    """
    for effect in _certain(model, recording):
        with suppress(*CANNOT_RUN):
            recovered = _recovered_with(effect, model, recording, calibrate, settings)
            if _nis(recovered.after) < BROKEN_NIS:
                return recovered.after, [recovered]
    try:
        first = examine(model, recording, calibrate, settings)
    except FilterDivergedError:
        mended = _recover(model, recording, calibrate, settings)
        if mended is None:
            raise
        return mended.after, [mended]
    if _nis(first) > BROKEN_NIS:
        mended = _recover(model, recording, calibrate, settings)
        if mended is not None and _nis(mended.after) < MENDED_PART * _nis(first):
            return mended.after, [mended]
    return first, []


def _certain(model: SensorModel, recording: RecordingSummary) -> Iterator[Effect]:
    """Yield effects that the model lacks and that the recording shows before the filter runs."""
    present = {effect.name for effect in model.effects}
    yield from (EFFECTS[name] for name in sorted(recording.certain - present))
    offset = late_images(recording)
    if offset is not None and not any(effect.acts_on == 'time' for effect in model.effects):
        yield offset


def _nis(examined: ExaminedModel) -> float:
    history = examined.run.history
    return nis_per_dof(history.nis, history.dof) or 0.0


def _recover(
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings,
) -> Addition | None:
    """Find the effect whose absence makes the filter diverge: the one with which it runs best, or None.

    With a walk of the bias it follows a law that no effect has, however large. Late images look like a gyro
    that reads ahead of time. An effect with such a sign is only taken where the filter runs with no other.
    """
    present = {effect.name for effect in model.effects}
    others = [item for item in EFFECTS.values() if may_break_the_filter(item) and not is_limit(item)]
    effects = [*detected_limits(model, recording.readings), *others, *_walks()]
    missing = [effect for effect in effects if effect.name not in present]
    found = side_by_side(calibrate, [partial(_with_it, effect, model, calibrate) for effect in missing])
    runs = [(*merit, effect) for merit, effect in zip(found, missing, strict=True) if merit is not None]
    if not runs:
        return None
    *_, best = max(runs, key=lambda item: item[:2])
    return _recovered_with(best, model, recording, calibrate, settings)


def _with_it(effect: Effect, model: SensorModel, calibrate: Calibrate) -> tuple[bool, float] | None:
    """Return whether an effect has a possible sign, and the log-likelihood of a measurement; or no run."""
    with suppress(*CANNOT_RUN):
        run = calibrate(with_effect(model, effect), ())
        history, k = run.history, len(effect.coefficients)
        impossible = has_impossible_sign(effect, run.state.coefficients[-k:], history.std[-1, -k:])
        return not impossible, float(history.log_likelihood.sum() / history.dof.sum())
    return None


def _walks() -> Iterator[Effect]:
    """Yield walks of the bias that no gyro has, with which the filter follows whatever it does."""
    for effect in EFFECTS.values():
        if is_bias_walk(effect):
            sizes = [size for size in effect.coefficients[0].scan if is_unusual(effect, size)]
            yield from (with_means(effect, (size,)) for size in sizes[::STRIDE])


def _recovered_with(
    effect: Effect,
    model: SensorModel,
    recording: RecordingSummary,
    calibrate: Calibrate,
    settings: DiagnosisSettings,
) -> Addition:
    after = examine(with_effect(model, effect), recording, calibrate, settings)
    stds = np.zeros(len(effect.coefficients))
    return Addition(effect, None, after, math.inf, math.inf, 0.0, stds, strengths(effect))
