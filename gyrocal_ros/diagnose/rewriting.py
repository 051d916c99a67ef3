"""Closed forms in place of learned curves and memories: the same law with few coefficients.

A curve has a dozen coefficients, and what is not known of them yet makes the heading drift. Its closed form
has one or two.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.diagnose.additions import Addition, Search
from gyrocal_ros.diagnose.closed_forms import ClosedForm
from gyrocal_ros.diagnose.examined import Calibrate, ExaminedModel, examine, with_effect, without_effect
from gyrocal_ros.diagnose.learned_laws import learned_laws
from gyrocal_ros.effects.base import LinearMemoryEffect
from gyrocal_ros.effects.learned.formula import Formula, formula
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Coefficient, Effect, Memory, SensorModel

MIN_EXPLAINED = 0.98
"""Part of a curve that its closed form explains at least to be tried: the curve itself is not exact."""
SLOPE_PART, MAX_STEP = 1e-3, 0.1
"""Parts of the fixed parameter of a form: half the difference of a derivative, and the largest change."""


def rewrite(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Write every learned law in its closed form, if that predicts the recording as well.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    for law in list(learned_laws(searched.last)):
        if not law.forms or law.forms[0].explained < MIN_EXPLAINED:
            continue
        with suppress(*CANNOT_RUN):
            added = _rewritten(searched.last, law.effect, law.forms[0], recording, calibrate)
            searched = replace(searched, additions=(*searched.additions, added))
    return searched


@dataclass(frozen=True)
class _Slope(LinearMemoryEffect):
    """The derivative of a closed form by its fixed parameter, for the filter to carry."""

    formula: Formula
    values: tuple[float, ...]
    """(q,) its coefficients."""
    name: str = 'slope of a closed form'
    coefficients: tuple[Coefficient, ...] = (Coefficient('parameter', '1', prior_std=1.0),)

    def remembered(self, block: MotionBlock, memory: Memory) -> tuple[Array, Memory]:
        """Return the derivative (N, 1), by a difference."""
        half = SLOPE_PART * self.formula.parameter
        less, more = (replace(self.formula, parameter=self.formula.parameter + way * half) for way in (-1, 1))
        before = memory if memory is not None else (None, None)
        low, low_memory = less.remembered(block, before[0])
        high, high_memory = more.remembered(block, before[1])
        return ((high - low) @ np.array(self.values) / (2.0 * half))[:, None], (low_memory, high_memory)


def _refined(present: ExaminedModel, effect: Formula, form: ClosedForm, calibrate: Calibrate) -> Formula:
    """Return the effect with the likeliest fixed parameter: one step of Newton from that of the curve."""
    if not effect.parameter:
        return effect
    slope = _Slope(effect, tuple(form.values.tolist()))
    scores = calibrate(_with(present, effect), (slope,)).scores
    assert scores is not None
    information, score = float(scores.information.sum()), float(scores.score.sum())
    farthest = MAX_STEP * effect.parameter
    step = float(np.clip(score / information, -farthest, farthest)) if information > 0.0 else 0.0
    return replace(effect, parameter=effect.parameter + step)


def _with(present: ExaminedModel, effect: Formula) -> SensorModel:
    return with_effect(without_effect(present.model, effect.name), effect)


def _rewritten(
    present: ExaminedModel,
    learned: Effect,
    form: ClosedForm,
    recording: RecordingSummary,
    calibrate: Calibrate,
) -> Addition:
    """Run the filter with a closed form in place of a learned effect."""
    effect = _of_usual_size(formula(learned.name, form.form.name, form.parameter), form)
    effect = _refined(present, effect, form, calibrate)
    after = examine(_with(present, effect), recording, calibrate, present.settings)
    count = len(effect.coefficients)
    return Addition(
        effect=effect,
        before=present,
        after=after,
        gain=0.0,
        sigma=0.0,
        p_value=1.0,
        stds=np.zeros(count),
        strengths=np.arange(count),
        is_rewritten=True,
    )


def _of_usual_size(effect: Formula, form: ClosedForm) -> Formula:
    """Return the effect with priors as large as the largest coefficient of that unit."""
    sizes: dict[str, float] = {}
    for item, value in zip(effect.coefficients, form.values.tolist(), strict=True):
        sizes[item.unit] = max(sizes.get(item.unit, 0.0), abs(value))
    items = tuple(replace(item, prior_std=sizes[item.unit]) for item in effect.coefficients)
    return replace(effect, coefficients=items)
