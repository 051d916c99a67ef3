"""Closed forms in place of learned curves, memories, maps and waves: the same law with few coefficients.

A curve has a dozen coefficients, and what is not known of them yet makes the heading drift. Its closed form
has one or two.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gyrocal_ros.data import Array, MotionBlock
from gyrocal_ros.diagnose.analysis.examined import ExaminedModel, examine, with_effect, without_effect
from gyrocal_ros.diagnose.analysis.runs import Calibrate
from gyrocal_ros.diagnose.laws.learned_laws import LearnedLaw, learned_laws
from gyrocal_ros.diagnose.search.additions import Addition, Search
from gyrocal_ros.effects.learned.bump import Bump
from gyrocal_ros.effects.learned.effect_code import Closed
from gyrocal_ros.effects.learned.formula import formula
from gyrocal_ros.effects.learned.wave import ORDERS, Wave, sine_of
from gyrocal_ros.errors import CANNOT_RUN
from gyrocal_ros.model.recording import RecordingSummary
from gyrocal_ros.model.sensor import Coefficient, GyroTerm, Memory, Place, SensorModel

MIN_EXPLAINED = 0.98
"""Part of a curve that its closed form explains at least to be tried: the curve itself is not exact."""
SLOPE_PART, MAX_STEP = 1e-3, 0.1
"""Parts of the scale of a fixed parameter: half the difference of a derivative, and the largest change."""


def rewrite(searched: Search, recording: RecordingSummary, calibrate: Calibrate) -> Search:
    """Write every learned law in its closed form, if that predicts the recording as well.

    Args:
        searched: a finished search.
        recording: summary of the recording.
        calibrate: runs the filter.
    """
    for law in list(learned_laws(searched.last)):
        for closed, values in _closed(law, searched.last):
            with suppress(*CANNOT_RUN):
                added = _rewritten(searched.last, closed, values, recording, calibrate)
                searched = replace(searched, additions=(*searched.additions, added))
                if added.is_kept:
                    break
    return searched


def closed_form(law: LearnedLaw, present: ExaminedModel) -> tuple[Closed, Array] | None:
    """Return a law in closed form with its coefficients (q,): as the model has it, else its best one.

    Args:
        law: a law of the model.
        present: the model.

    Returns:
        None for a law without a closed form.
    """
    if isinstance(law.effect, Closed):
        return law.effect, present.estimate_of(law.effect.name)[0]
    closest = _closest(law)
    return None if closest is None else closest[:2]


def size_of(law: LearnedLaw, present: ExaminedModel) -> int:
    """Return the number of parameters of a law of a model, in closed form if that misses only chance."""
    closed = next(_closed(law, present), None)
    if closed is None or (law.forms and not law.forms[0].fits):
        return len(law.effect.coefficients)
    return len(closed[0].coefficients) + len(closed[0].parameters)


def _closed(law: LearnedLaw, present: ExaminedModel) -> Iterator[tuple[Closed, Array]]:
    """Yield closed forms of a law as effects with their coefficients (q,), the simplest first."""
    if isinstance(law.effect, Wave):
        values = present.estimate_of(law.effect.name)[0]
        yield sine_of(law.effect.name, law.effect.period_s), values[[0, len(ORDERS)]]
        yield law.effect, values
        return
    closest = _closest(law)
    if closest is not None and closest[2] > MIN_EXPLAINED:
        yield closest[:2]


def _closest(law: LearnedLaw) -> tuple[Closed, Array, float] | None:
    """Return the best closed form of a learned law, its coefficients (q,), and the part that it explains."""
    if law.bump is not None:
        found = law.bump
        at_place = Bump().at((found.x_m, found.y_m, found.width_m))
        return at_place, np.array([found.height]), found.explained
    if law.forms:
        best = law.forms[0]
        return formula(law.effect.name, best.form.name, best.parameter), best.values, best.explained
    return None


def _rewritten(
    present: ExaminedModel,
    closed: Closed,
    values: Array,
    recording: RecordingSummary,
    calibrate: Calibrate,
) -> Addition:
    """Run the filter with a closed form in place of a learned effect."""
    effect = _refined(present, _of_usual_size(closed, values), values, calibrate)
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


def _of_usual_size(effect: Closed, values: Array) -> Closed:
    """Return the effect with priors as large as the largest coefficient (q,) of that unit."""
    sizes: dict[str, float] = {}
    for item, value in zip(effect.coefficients, values.tolist(), strict=True):
        sizes[item.unit] = max(sizes.get(item.unit, 0.0), abs(value))
    items = tuple(replace(item, prior_std=sizes[item.unit]) for item in effect.coefficients)
    return replace(effect, coefficients=items)


@dataclass(frozen=True)
class _Slopes:
    """The derivatives of a closed form by its fixed parameters, for the filter to carry."""

    closed: Closed
    values: tuple[float, ...]
    """(q,) its coefficients."""
    acts_on: ClassVar[Place] = 'gyro'
    name: str = 'slopes of a closed form'

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """One for each parameter."""
        return tuple(Coefficient(f'p{n}', '1', prior_std=1.0) for n in range(len(self.closed.parameters)))

    def contribute(self, block: MotionBlock, values: Array, memory: Memory) -> GyroTerm:
        """Return the derivatives (N, p), by differences."""
        memory = memory if memory is not None else [(None, None)] * len(values)
        columns, after = [], []
        for place, (scale, (before_low, before_high)) in enumerate(
            zip(self.closed.scales, memory, strict=True)
        ):
            half = SLOPE_PART * scale
            low = self._moved(place, -half).contribute(block, np.array(self.values), before_low)
            high = self._moved(place, half).contribute(block, np.array(self.values), before_high)
            columns.append((high.rate_rad_s - low.rate_rad_s) / (2.0 * half))
            after.append((low.memory, high.memory))
        slopes = np.stack(columns, axis=1)
        return GyroTerm(slopes @ values, slopes, after)

    def _moved(self, place: int, by: float) -> Closed:
        parameters = list(self.closed.parameters)
        parameters[place] += by
        return self.closed.at(tuple(parameters))


def _refined(present: ExaminedModel, effect: Closed, values: Array, calibrate: Calibrate) -> Closed:
    """Return the effect with the likeliest fixed parameters: one step of Newton from those of the curve."""
    if not effect.parameters:
        return effect
    scores = calibrate(_with(present, effect), (_Slopes(effect, tuple(values.tolist())),)).scores
    assert scores is not None
    steps = np.linalg.lstsq(scores.information.sum(axis=0), scores.score.sum(axis=0), rcond=None)[0]
    most = MAX_STEP * np.array(effect.scales)
    refined = np.array(effect.parameters) + np.clip(steps, -most, most)
    return effect.at(tuple(refined.tolist()))


def _with(present: ExaminedModel, effect: Closed) -> SensorModel:
    return with_effect(without_effect(present.model, effect.name), effect)
